"""What MuJoCo is told about the cloth, and what it makes of it."""

from __future__ import annotations

import numpy as np
import pytest

from clothrf_core.params import Fabric, SimulationParams

mujoco = pytest.importorskip("mujoco", reason="needs the extra 'mujoco'")

from clothrf_mujoco.config import FlexOptions  # noqa: E402
from clothrf_mujoco.flex import flex, membrane  # noqa: E402
from clothrf_mujoco.simulator import FlexSimulator  # noqa: E402

FABRIC = Fabric(stretch_warp=300.0, stretch_weft=500.0, shear=40.0, damping=0.0, drag=0.0)
NOWHERE = np.zeros((2, 3))


def cloth(fabric: Fabric = FABRIC, **changes: object):
    values = {"hands": NOWHERE, "grasp": NOWHERE, "resolution": (5, 6), **changes}
    params = SimulationParams(fabric=fabric, **values)
    return flex(params, FlexOptions(taut=1.0))


def pull(strained, f, height=0.0):
    """(V, 3) elastic forces of the sheet with every vertex at `strained` (V, 2) and `height`."""
    data = mujoco.MjData(f.model)
    f.model.opt.gravity[:] = 0.0
    at = np.concatenate([strained, np.zeros((len(strained), 1))], axis=1)
    at[:, 2] = height
    data.qpos[:] = (at - f.flat).ravel()
    mujoco.mj_forward(f.model, data)
    return data.qfrc_passive.reshape(-1, 3)


@pytest.mark.parametrize(("axis", "modulus"), [(0, 500.0), (1, 300.0)])
def test_warp_and_weft_pull_with_their_own_stiffness(axis, modulus):
    f, strain = cloth(), 1e-4
    rest = f.mesh.rest
    stretch = np.ones(2)
    stretch[axis] += strain

    forces = pull(rest * stretch, f)

    at_end = np.isclose(rest[:, axis], rest[:, axis].max())
    width = rest[:, 1 - axis].max()
    assert -forces[at_end, axis].sum() == pytest.approx(modulus * width * strain, rel=1e-3)


def test_shear_pulls_with_the_fabric_s_shear_stiffness():
    f, angle = cloth(), 1e-4
    rest = f.mesh.rest

    forces = pull(rest + angle * np.stack([rest[:, 1], 0 * rest[:, 1]], axis=1), f)

    at_end = np.isclose(rest[:, 1], 0.35)
    assert -forces[at_end, 0].sum() == pytest.approx(40.0 * 0.30 * angle, rel=1e-3)


def test_an_isotropic_fabric_gets_the_matrix_that_mujoco_itself_compiles():
    edges = np.array([[0.0, 0.03], [0.02, 0.03], [0.02, 0.0]])
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <body name="a"><joint type="slide"/><inertial pos="0 0 0" mass="1"
            diaginertia="1 1 1"/></body>
        <body name="b" pos=".02 0 0"><joint type="slide"/><inertial pos="0 0 0" mass="1"
            diaginertia="1 1 1"/></body>
        <body name="c" pos=".02 .03 0"><joint type="slide"/><inertial pos="0 0 0" mass="1"
            diaginertia="1 1 1"/></body>
        </worldbody><deformable><flex name="f" dim="2" body="a b c" element="0 1 2">
        <contact selfcollide="none"/>
        <elasticity young="1e6" poisson="0" thickness="1e-3" damping="1" elastic2d="both"/>
        </flex></deformable></mujoco>"""
    )
    wanted = {tuple(np.abs(e).round(9)): i for i, e in enumerate(edges)}
    ends = model.flex_edge[model.flex_elemedge]
    place = np.array([[0, 0], [0.02, 0], [0.02, 0.03]])
    order = [wanted[tuple(np.abs(place[j] - place[i]).round(9))] for i, j in ends]

    ours = membrane(edges[order], np.array([1e3, 1e3, 0.5e3]), 0.5 * 0.02 * 0.03)

    assert np.allclose(ours[np.triu_indices(3)], model.flex_stiffness[:6], rtol=1e-9)


@pytest.mark.parametrize(
    ("shape", "squared"),
    [
        (lambda u, v: 0.5 * u * u, 1.0),
        (lambda u, v: 0.5 * v * v, 1.0),
        (lambda u, v: u * v, 2.0),
    ],
    ids=["about v", "about u", "twist"],
)
def test_curvature_and_twist_cost_what_the_bending_stiffness_says(shape, squared):
    limp = Fabric(stretch_warp=1e-12, stretch_weft=1e-12, shear=0.0, bending=1e-3, damping=0.0)
    f = cloth(limp, resolution=(21, 24))
    z = shape(*f.mesh.rest.T)

    forces = pull(f.mesh.rest, f, z)

    # Half the stiffness times the squared second derivatives; flaps end half a cell from a border.
    wanted = 0.5 * 1e-3 * squared * 0.30 * 0.35
    assert -0.5 * z @ forces[:, 2] == pytest.approx(wanted, rel=0.06)


def test_the_sheet_weighs_what_its_density_says():
    f = cloth()

    free = f.mass.sum()
    corners = FABRIC.density * 0.30 * 0.35 / (4 * 5)
    assert free + corners == pytest.approx(FABRIC.density * 0.30 * 0.35)


def test_a_strip_between_its_two_ends_hangs_as_a_catenary():
    # Two vertices wide, so the four corners are its whole ends; L = 0.35 m over 0.25 m.
    hands = np.array([[0.25, 0.0, 0.3], [0.25, 0.02, 0.3]])
    params = SimulationParams(
        hands=hands,
        grasp=hands - [0.25, 0.0, 0.0],
        size=(0.02, 0.35),
        resolution=(2, 36),
        fabric=Fabric(stretch_warp=5e3, stretch_weft=5e3, bending=0.0),
        settle_s=8.0,
    )
    state = FlexSimulator(FlexOptions()).reset(np.random.default_rng(0), params)

    a = np.linspace(0.01, 1.0, 200001)
    a = a[np.argmin(np.abs(2 * a * np.sinh(0.125 / a) - 0.35))]
    sag = a * (np.cosh(0.125 / a) - 1)
    assert 0.3 - state.vertices[:, 2].min() == pytest.approx(sag, abs=0.5e-3)
