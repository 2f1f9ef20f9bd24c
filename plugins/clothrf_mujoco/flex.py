"""From fabric, size and resolution to a MuJoCo model: one 2D flex of point masses.

The flex's energy is ``sum over triangles of e' K e / 4``, where e holds the squared lengths of the
three edges less their rest values (St. Venant-Kirchhoff; Weischedel 2012 gives it by edges). MuJoCo
fills K for an isotropic material; a weave has two directions and hardly any shear, so we put the
orthotropic K in its place. Bending is the quadratic form over edge flaps of Wardetzky et al. 2007,
scaled to the fabric's, twist and curvature alike. Both are integrated implicitly by the
``discrete`` integrator.

Layers are kept apart by its ``ipc`` mode, whose every step is checked to be free of intersections:
the usual soft contacts left the folds of a twisted cloth as crossed as none.

Flex takes no kinematic vertices where it is elastic: the held corners weigh so much that no force
of the cloth moves them, and are told position and speed before each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from clothrf_core.errors import MissingDependency
from clothrf_core.params import Fabric, SimulationParams
from clothrf_core.sheet import check_cloth, grid_mesh
from clothrf_core.types import ClothMesh, Float
from clothrf_mujoco.config import FlexOptions

OLDEST = 4
"""Major version of MuJoCo from which flexes are integrated implicitly."""
HELD_MASS = 1e6
"""kg of a held corner; the heaviest of fabrics pulled a metre moves it by less than 1e-6 m."""
GRAVITY = 9.81
UNIT_THICKNESS = 1e-3
UNIT_YOUNG = 12.0 / UNIT_THICKNESS**3
"""Compiled with these, the bending stiffness is 1 N m."""


@dataclass(frozen=True, slots=True, eq=False)
class Flex:
    """A cloth that MuJoCo can step; a vertex is three sliding joints.

    Attributes:
        model: the ``mujoco.MjModel``; its time step and drag are set anew by whoever steps it.
        mesh: topology for the outside.
        flat: (V, 3) metres, where ``qpos`` counts from.
        mass: (V,) kg; zero at the held corners.
        collides: whether its layers are to be kept apart.
        held: (12,) indices into qpos and qvel of the four corners.
    """

    model: Any
    mesh: ClothMesh
    flat: Float
    mass: Float
    collides: bool
    held: NDArray[np.int64]


def flex(params: SimulationParams, options: FlexOptions) -> Flex:
    """Compile the cloth.

    Raises:
        ConfigError: size, resolution or fabric are out of range.
        MissingDependency: MuJoCo is too old.
    """
    check_cloth(params)
    if int(mujoco.__version__.split(".")[0]) < OLDEST:
        raise MissingDependency(
            f"simulator 'mujoco': expected mujoco >= {OLDEST}.0, which integrates flex "
            f"implicitly, found {mujoco.__version__}. Install it with: pip install "
            "'clothrf[mujoco]'"
        )
    mesh = grid_mesh(params.size, params.resolution)
    mass = _masses(mesh, params)
    model = mujoco.MjModel.from_xml_string(_xml(mesh, mass, options, collide=params.self_collision))
    # A step that went wrong must be seen and mended here, not silently start from the rest shape.
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    fabric = params.fabric
    model.flex_stiffness[:] = _stiffness(model, mesh, fabric, options.taut).ravel()
    model.flex_bending[:] *= fabric.bending * _bending_shares(model, mesh)
    model.flex_damping[0] = fabric.damping  # compiled without any, there would be no room for it
    mass[mesh.corners] = 0.0
    return Flex(
        model=model,
        mesh=mesh,
        flat=np.concatenate([mesh.rest, np.zeros((len(mesh.rest), 1))], axis=1),
        mass=mass,
        collides=params.self_collision,
        held=(3 * mesh.corners[:, None].astype(np.int64) + np.arange(3)).ravel(),
    )


def membrane(edges: Float, moduli: Float, area: float) -> Float:
    """(3, 3) K of a triangle with ``e' K e / 4`` for its energy.

    An edge d under the Green strain E gains ``2 d' E d`` of squared length, so three edges give
    back the three strains.

    Args:
        edges: (3, 2) metres, u and v.
        moduli: (3,) N/m along u, along v and in shear (engineering shear strain).
        area: m^2.
    """
    u, v = edges.T
    strains = np.linalg.inv(2.0 * np.stack([u * u, v * v, u * v], axis=1))
    stiffness: Float = 2.0 * area * strains.T @ np.diag(moduli) @ strains
    return stiffness


def _stiffness(model: Any, mesh: ClothMesh, fabric: Fabric, taut: float) -> Float:
    """(M, ...) as MuJoCo keeps it: six entries of the upper triangle first, then zeros."""
    moduli = np.array([taut * fabric.stretch_weft, taut * fabric.stretch_warp, fabric.shear])
    ends = model.flex_edge[model.flex_elemedge.reshape(-1, 3)]
    edges = mesh.rest[ends[:, :, 1]] - mesh.rest[ends[:, :, 0]]
    area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    kept = np.zeros((len(edges), model.nflexstiffness // len(edges)))
    for row, three, a in zip(kept, edges, area, strict=True):
        row[:6] = membrane(three, moduli, float(a))[np.triu_indices(3)]
    return kept


def _bending_shares(model: Any, mesh: ClothMesh) -> Float:
    """For every entry of ``flex_bending``: a half in flaps over a diagonal, else one.

    On our grid a flap over an edge of a cell sees one curvature and a flap over a diagonal the
    twist; MuJoCo makes the plate twice as stiff in twist as in bending.
    """
    way = np.abs(np.diff(mesh.rest[model.flex_edge], axis=1)[:, 0])
    share = np.where(way.min(axis=1) > 1e-9, 0.5, 1.0)
    shares: Float = np.repeat(share, len(model.flex_bending) // len(share))
    return shares


def _masses(mesh: ClothMesh, params: SimulationParams) -> Float:
    """(V,) kg: a vertex at a border has half of a cell's, one at a corner a quarter."""
    cells = np.array(params.resolution) - 1
    at_border = np.isclose(mesh.rest, 0.0) | np.isclose(mesh.rest, params.size)
    share = np.where(at_border, 0.5, 1.0).prod(axis=1)
    mass: Float = params.fabric.density * np.prod(np.array(params.size) / cells) * share
    return mass


def _xml(mesh: ClothMesh, mass: Float, options: FlexOptions, *, collide: bool) -> str:
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    corners = set(mesh.corners.tolist())
    bodies = "".join(
        f'<body name="{i}" pos="{u!r} {v!r} 0" gravcomp="{int(i in corners)}">'
        f'<inertial pos="0 0 0" mass="{HELD_MASS if i in corners else m!r}" '
        f'diaginertia="1e-9 1e-9 1e-9"/>{slides}</body>'
        for i, ((u, v), m) in enumerate(zip(mesh.rest.tolist(), mass.tolist(), strict=True))
    )
    names = " ".join(map(str, range(len(mass))))
    elements = " ".join(map(str, mesh.triangles.ravel().tolist()))
    contact = (
        'selfcollide="auto" condim="1"'
        if collide
        else 'selfcollide="none" contype="0" conaffinity="0"'
    )
    return f"""<mujoco>
    <option integrator="discrete" solver="CG" gravity="0 0 {-GRAVITY}"/>
    <size memory="200M"/>
    <worldbody>{bodies}</worldbody>
    <deformable>
      <flex name="cloth" dim="2" radius="{options.thickness / 2!r}" body="{names}"
          element="{elements}">
        <contact {contact}/>
        <elasticity young="{UNIT_YOUNG!r}" poisson="0" thickness="{UNIT_THICKNESS!r}"
            damping="1" elastic2d="both"/>
      </flex>
    </deformable>
    </mujoco>"""
