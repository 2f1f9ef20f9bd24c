from __future__ import annotations

import clothrf_how
import pytest
from clothrf_how.config import ForegroundOptions, HowOnlyOptions, HowOptions

from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.testing.features import check_feature_extractor


@pytest.mark.parametrize("name", ["how", "how_only"])
def test_every_extractor_keeps_the_contract(rig, name):
    registry = Registry.of(clothrf_how)

    check_feature_extractor(
        lambda: registry.build("features", name, context=BuildContext(rig=rig)), rig
    )


@pytest.mark.parametrize("layout", ["A", "B", "C", "D"])
@pytest.mark.parametrize("align", ["none", "center", "center_scale"])
def test_every_layout_and_alignment_keeps_the_contract(rig, layout, align):
    registry = Registry.of(clothrf_how)
    options = HowOnlyOptions(how=HowOptions(layout=layout, align=align))

    check_feature_extractor(
        lambda: registry.build("features", "how_only", options, BuildContext(rig=rig)), rig
    )


def test_full_resolution_keeps_the_contract(rig):
    registry = Registry.of(clothrf_how)
    options = HowOnlyOptions(foreground=ForegroundOptions(halve=False))

    check_feature_extractor(
        lambda: registry.build("features", "how_only", options, BuildContext(rig=rig)), rig
    )


def test_without_a_rig_anything_measured_is_cloth(rig, sheet, observe):
    extractor = Registry.of(clothrf_how).build("features", "how_only")

    assert extractor.extract(observe(sheet)).valid
