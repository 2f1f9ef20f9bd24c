"""Joint order and units, held against the reference poses of the controller."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from clothrf_egm.mapping import from_egm, to_egm

REFERENCE = Path(__file__).parents[2] / "data" / "yumi" / "fk_reference.json"


def test_the_chain_becomes_the_controllers_axes_and_back():
    for pose in json.loads(REFERENCE.read_text())["poses"]:
        for side in ("left", "right"):
            chain = np.radians(pose[side]["joints_deg_chain_1_2_7_3_4_5_6"])
            joints, external = to_egm(chain)
            np.testing.assert_allclose(joints, pose[side]["robax_deg"], atol=1e-12)
            np.testing.assert_allclose(external, [pose[side]["extax_a_deg"]], atol=1e-12)
            np.testing.assert_allclose(from_egm(joints, external), chain, atol=1e-15)


def test_axis_7_is_the_external_joint():
    joints, external = to_egm(np.radians([1.0, 2.0, 7.0, 3.0, 4.0, 5.0, 6.0]))
    np.testing.assert_allclose(joints, [1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(external, [7])
