"""A third party's plugin: one policy of its own, and small components to train it with."""

from __future__ import annotations

from pydantic import Field

from clothrf_core.hookspecs import hookimpl
from clothrf_core.provider import Provider
from clothrf_core.rig import Section


class MeanConfig(Section):
    shrink: float = Field(0.0, ge=0.0, le=1.0, description="pull of the answer to the anchor")


@hookimpl
def clothrf_policies():
    return [Provider("toy_mean", "the mean target, seen from the anchor", _policy, MeanConfig)]


@hookimpl
def clothrf_simulators():
    return [Provider("toy_sheet", "a massless sheet", _simulator)]


@hookimpl
def clothrf_cameras():
    return [Provider("toy_splat", "draws triangles as squares", _camera)]


@hookimpl
def clothrf_features():
    return [Provider("toy_blocks", "mean points of 4 x 4 blocks", _features)]


@hookimpl
def clothrf_experts():
    return [Provider("toy_offset", "grippers 0.3 m in front of the hands", _expert)]


@hookimpl
def clothrf_hands():
    return [Provider("toy_circle", "both hands on a small circle", _hands)]


@hookimpl
def clothrf_randomizers():
    return [Provider("toy_none", "nothing varies", _randomizer)]


def _policy(config, context):
    from clothrf_toy.policy import MeanPolicy

    return MeanPolicy(config.shrink)


def _simulator(config, context):
    from clothrf_core.testing.fakes import SheetSimulator

    return SheetSimulator()


def _camera(config, context):
    from clothrf_core.testing.fakes import SplatCamera

    return SplatCamera(context.world)


def _features(config, context):
    from clothrf_core.testing.fakes import BlockFeatures

    return BlockFeatures()


def _expert(config, context):
    from clothrf_core.testing.fakes import OffsetExpert

    return OffsetExpert()


def _hands(config, context):
    from clothrf_core.testing.fakes import CirclingHands

    return CirclingHands(context.rig.rest_hands)


def _randomizer(config, context):
    from clothrf_core.testing.fakes import NoRandomizer

    return NoRandomizer()
