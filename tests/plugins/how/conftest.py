from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from clothrf_core.rig import Rig
from clothrf_core.testing.features import draw_sheet
from clothrf_core.types import GraspState, Observation, RgbdFrame

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def rig() -> Rig:
    with (ROOT / "configs/rigs/yumi_sr300.toml").open("rb") as file:
        return Rig.model_validate(tomllib.load(file))


@pytest.fixture(scope="session")
def sheet(rig: Rig) -> RgbdFrame:
    return draw_sheet(rig)


@pytest.fixture(scope="session")
def observe():
    def make(frame: RgbdFrame) -> Observation:
        return Observation(frame, GraspState(np.zeros((2, 3)), 0))

    return make
