"""From fabric, size and resolution to the numbers that the kernels work on.

The cloth is a grid of R rows and C columns of vertices, C <= R, vertex ``a = r C + c``: the short
side runs fastest, which keeps the Hessian's band narrow. Columns run along u when there are no
more vertices along u than along v, else along v.

Springs (four families, each given by its offset in a): along a column, along a row, and the two
diagonals of a cell. Their stiffnesses give the continuum's moduli: with cells of du x dv and
diagonals of length l, ``k_diagonal = G l^2 / (2 du dv)`` has shear stiffness G and adds
``G (du/dv)^2`` to the stretch along u and G to the coupling of both, so the edges get what is left
of ``C_uu``, where ``C_uu - G^2 / C_vv`` is the Young's modulus asked for.

Bending is isometric: half the bending stiffness times the squared second differences along both
directions plus twice the mixed one, a constant quadratic form (Bergou et al. 2006; the squared
Hessian of Stein et al. 2018, whose free edges are natural).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clothrf_core.params import Fabric, SimulationParams
from clothrf_core.sheet import check_cloth, grid_mesh
from clothrf_core.types import ClothMesh, Float

GRAVITY = 9.81
CONTACT = 1.0
"""Stiffness of self-contact, times the stretch stiffness."""


@dataclass(frozen=True, slots=True, eq=False)
class Weave:
    """A cloth as arrays; V = R C vertices, free of any pose.

    Attributes:
        size: along u and v, m.
        rows: R.
        columns: C.
        springs: (4, V) stiffness of the spring from vertex a to a + 1, a + C, a + C + 1 and (from
            a + 1) to a + C, N/m; zero where the grid ends.
        lengths: (4,) rest lengths, m.
        limits: (4,) lengths beyond which a spring is taut, m; infinite for diagonals.
        bending: (3, V) weights, N/m, of ``|x_{a-1} - 2 x_a + x_{a+1}|^2 / 2``, the same with C for
            1, and ``|x_a - x_{a+1} - x_{a+C} + x_{a+C+1}|^2 / 2``.
        mass: (V,) kg.
        numbers: (3,) damping time s, drag 1/s, taut stiffness over stretch stiffness.
        layers: (2,) stiffness, N/m, and thickness, m, of self-contact; stiffness 0 = none.
        mesh: topology for the outside.
    """

    size: tuple[float, float]
    rows: int
    columns: int
    springs: Float
    lengths: Float
    limits: Float
    bending: Float
    mass: Float
    numbers: Float
    layers: Float
    mesh: ClothMesh


def weave(
    params: SimulationParams, *, strain_limit: float, taut: float, thickness: float = 0.0
) -> Weave:
    """The numbers of a cloth.

    Raises:
        ConfigError: size, resolution or fabric are out of range.
    """
    check_cloth(params)
    (width, length), (nu, nv) = params.size, params.resolution
    fabric = params.fabric
    du, dv = width / (nu - 1), length / (nv - 1)
    along_u, along_v, diagonal = _stiffnesses(fabric, du, dv)
    # p runs along a row's vertices (the columns direction), q from row to row.
    flipped = nu > nv
    (np_, nq) = (nv, nu) if flipped else (nu, nv)
    (dp, dq) = (dv, du) if flipped else (du, dv)
    (kp, kq) = (along_v, along_u) if flipped else (along_u, along_v)

    edge_p = np.ones(np_)
    edge_p[[0, -1]] = 0.5
    edge_q = np.ones(nq)
    edge_q[[0, -1]] = 0.5
    inner_p = np.ones(np_)
    inner_p[[0, -1]] = 0.0
    inner_q = np.ones(nq)
    inner_q[[0, -1]] = 0.0
    has_p = np.ones(np_)
    has_p[-1] = 0.0
    has_q = np.ones(nq)
    has_q[-1] = 0.0

    springs = np.zeros((4, nq, np_))
    springs[0] = kp * edge_q[:, None] * has_p[None, :]
    springs[1] = kq * has_q[:, None] * edge_p[None, :]
    springs[2] = springs[3] = diagonal * has_q[:, None] * has_p[None, :]
    area = dp * dq
    bending = np.zeros((3, nq, np_))
    bending[0] = fabric.bending * area / dp**4 * edge_q[:, None] * inner_p[None, :]
    bending[1] = fabric.bending * area / dq**4 * inner_q[:, None] * edge_p[None, :]
    bending[2] = 2.0 * fabric.bending / area * has_q[:, None] * has_p[None, :]
    mass = fabric.density * area * edge_q[:, None] * edge_p[None, :]
    hypotenuse = float(np.hypot(dp, dq))
    return Weave(
        size=(float(width), float(length)),
        rows=nq,
        columns=np_,
        springs=springs.reshape(4, -1),
        lengths=np.array([dp, dq, hypotenuse, hypotenuse]),
        limits=np.array([dp, dq, np.inf, np.inf]) * (1.0 + strain_limit),
        bending=bending.reshape(3, -1),
        mass=mass.reshape(-1),
        numbers=np.array([fabric.damping, fabric.drag, taut]),
        layers=np.array([CONTACT * fabric.stretch_warp * params.self_collision, thickness]),
        mesh=grid_mesh(params.size, params.resolution),
    )


def neighbours(columns: int) -> NDArray[np.int64]:
    """(4, 2) offsets in a of both ends of the spring families."""
    return np.array([[0, 1], [0, columns], [0, columns + 1], [1, columns]])


def _stiffnesses(fabric: Fabric, du: float, dv: float) -> tuple[float, float, float]:
    """Spring constants along u, along v and of the diagonals of a cell, N/m."""
    shear = fabric.shear
    c_uu, c_vv = fabric.stretch_weft, fabric.stretch_warp
    for _ in range(50):
        c_uu = fabric.stretch_weft + shear**2 / c_vv
        c_vv = fabric.stretch_warp + shear**2 / c_uu
    # In long cells the diagonals alone may be stiffer than asked for; edges keep a tenth.
    along_u = max(c_uu - shear * (du / dv) ** 2, 0.1 * c_uu) * dv / du
    along_v = max(c_vv - shear * (dv / du) ** 2, 0.1 * c_vv) * du / dv
    return along_u, along_v, shear * (du * du + dv * dv) / (2.0 * du * dv)
