"""Small cloths in known poses, and the kernels' numpy twins."""

from __future__ import annotations

import numpy as np
from clothrf_sapien.cloth import Cloths
from clothrf_sapien.contact import Contacts
from clothrf_sapien.elements import Past, Sheet
from clothrf_sapien.weave import Weave, neighbours, weave

from clothrf_core.params import Fabric, SimulationParams
from clothrf_core.types import Float

HANDS = np.array([[0.6, -0.14, 0.30], [0.6, 0.14, 0.30]])
GRASP = np.array([[0.3, -0.14, 0.32], [0.3, 0.14, 0.32]])
FABRIC = Fabric(stretch_warp=300.0, stretch_weft=500.0, shear=40.0, bending=3e-4, damping=4e-3)


def params(**changes: object) -> SimulationParams:
    values: dict[str, object] = {
        "hands": HANDS,
        "grasp": GRASP,
        "resolution": (7, 9),
        "settle_s": 0.2,
        **changes,
    }
    return SimulationParams(**values)  # type: ignore[arg-type]


def woven(resolution: tuple[int, int] = (5, 6), fabric: Fabric = FABRIC) -> Weave:
    return weave(params(resolution=resolution, fabric=fabric), strain_limit=0.01, taut=4.0)


def sheet(w: Weave, pins: Float) -> Sheet:
    return Sheet(
        w.springs,
        w.lengths,
        w.limits,
        w.bending,
        w.mass,
        w.numbers,
        np.asarray(pins, np.int64),
        w.columns,
        neighbours(w.columns),
    )


def crumpled(w: Weave, rng: np.random.Generator, *, stretch: float = 1.0) -> Float:
    """(V, 3) vertices near the flat cloth, scaled and shaken by a tenth of a cell."""
    flat = np.concatenate([w.mesh.rest * stretch, np.zeros((len(w.mass), 1))], axis=1)
    return flat + rng.normal(scale=0.1 * w.lengths.min(), size=flat.shape)


def past(w: Weave, rng: np.random.Generator, *, h: float = 1 / 30) -> Past:
    x = crumpled(w, rng)
    y = x + rng.normal(scale=1e-3, size=x.shape)
    rows = [np.ascontiguousarray(p.T) for p in (x, y, bending_matrix(w) @ x)]
    return Past(rows[0], rows[1], spring_lengths(w, x), rows[2], h, contacts())


def spring_ends(w: Weave) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Family, first and second vertices of all springs that exist."""
    found = []
    for f, (p, q) in enumerate(neighbours(w.columns)):
        a = np.flatnonzero(w.springs[f])
        found.append((f, a + p, a + q))
    return found


def spring_lengths(w: Weave, x: Float) -> Float:
    lengths = np.zeros_like(w.springs)
    for f, u, v in spring_ends(w):
        lengths[f, np.flatnonzero(w.springs[f])] = np.linalg.norm(x[v] - x[u], axis=1)
    return lengths


def bending_matrix(w: Weave) -> Float:
    """(V, V) K, from the definition: second differences along both directions and mixed."""
    num, c = len(w.mass), w.columns
    K = np.zeros((num, num))
    for stencil, weights in (
        ({-1: 1.0, 0: -2.0, 1: 1.0}, w.bending[0]),
        ({-c: 1.0, 0: -2.0, c: 1.0}, w.bending[1]),
        ({0: 1.0, 1: -1.0, c: -1.0, c + 1: 1.0}, w.bending[2]),
    ):
        for a in np.flatnonzero(weights):
            row = np.zeros(num)
            for offset, factor in stencil.items():
                row[a + offset] += factor
            K += weights[a] * np.outer(row, row)
    return K


def energy(x: Float, w: Weave, before: Past) -> float:
    """E(x) of `elements`, in plain numpy."""
    damping, drag, taut = w.numbers
    h, ratio = before.h, damping / before.h
    K = bending_matrix(w)
    total = float(
        np.sum(w.mass[:, None] * (x - before.y.T) ** 2) / (2 * h * h)
        + drag / (2 * h) * np.sum(w.mass[:, None] * (x - before.x.T) ** 2)
        + np.sum(x * (0.5 * (1 + ratio) * (K @ x) - ratio * (K @ before.x.T)))
    )
    for f, u, v in spring_ends(w):
        k = w.springs[f][w.springs[f] > 0]
        size = np.linalg.norm(x[v] - x[u], axis=1)
        was = np.linalg.norm(before.x.T[v] - before.x.T[u], axis=1)
        over = np.maximum(size - w.limits[f], 0.0)
        total += float(
            np.sum(
                k / 2 * ((size - w.lengths[f]) ** 2 + taut * over**2 + ratio * (size - was) ** 2)
            )
        )
    return total


def hessian(x: Float, w: Weave, before: Past) -> Float:
    """(3V, 3V) projected Hessian with the banded bending, in plain numpy."""
    damping, drag, taut = w.numbers
    ratio, num, c = damping / before.h, len(w.mass), w.columns
    K = bending_matrix(w)
    for a in np.flatnonzero(w.bending[1]):
        difference = np.zeros(num)
        difference[[a - c, a + c]] = 1.0, -1.0
        K += w.bending[1, a] * np.outer(difference, difference)
    inertia = w.mass * (1 / before.h**2 + drag / before.h)
    H = np.kron(np.diag(inertia) + (1 + ratio) * K, np.eye(3))
    for f, u, v in spring_ends(w):
        for a, b, k in zip(u, v, w.springs[f][w.springs[f] > 0], strict=True):
            d = x[b] - x[a]
            size = float(np.linalg.norm(d))
            d /= size
            was = float(np.linalg.norm(before.x.T[b] - before.x.T[a]))
            over = max(size - w.limits[f], 0.0)
            force = k * (size - w.lengths[f] + ratio * (size - was) + taut * over)
            slope = k * (1 + ratio + (taut if over > 0 else 0.0))
            across = max(force, 0.0) / size
            block = slope * np.outer(d, d) + across * (np.eye(3) - np.outer(d, d))
            for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                H[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += sign * block
    return H


def whole(matrix: np.ndarray, second: np.ndarray, columns: int) -> Float:
    """(3V, 3V) of a matrix of `stencil`."""
    num = matrix.shape[2]
    M = np.zeros((3 * num, 3 * num))
    for s, offset in enumerate((0, 1, columns, columns + 1, columns - 1)):
        for a in range(num - offset):
            block = np.zeros((3, 3))
            block[np.triu_indices(3)] = matrix[s, :, a]
            block += np.triu(block, 1).T
            i, j = slice(3 * a, 3 * a + 3), slice(3 * (a + offset), 3 * (a + offset) + 3)
            M[i, j] += block
            if offset:
                M[j, i] += block
    for i in range(3):
        M[i::3, i::3] += np.diag(second[: num - 2], 2) + np.diag(second[: num - 2], -2)
    return M


def dense(A: np.ndarray, columns: int, S: int, size: int) -> Float:
    """(size, size) symmetric matrix kept in the layout of `banded`."""
    M = np.zeros((columns, columns))
    for j in range(columns):
        for t in range(S - 8 - j % 8):
            if j + t < columns:
                M[j + t, j] = M[j, j + t] = A[j * S + j % 8 + t]
    return M[:size, :size]


def total_energy(w: Weave, cloths: Cloths) -> float:
    """Kinetic, gravitational and elastic, J."""
    x, v = cloths.x[0], cloths.v[0]
    total = float(np.sum(w.mass * (0.5 * np.sum(v * v, axis=1) + 9.81 * x[:, 2])))
    total += 0.5 * float(np.sum(x * (bending_matrix(w) @ x)))
    for f, a, b in spring_ends(w):
        k = w.springs[f][w.springs[f] > 0]
        size = np.linalg.norm(x[b] - x[a], axis=1)
        over = np.maximum(size - w.limits[f], 0.0)
        total += float(np.sum(k / 2 * ((size - w.lengths[f]) ** 2 + w.numbers[2] * over**2)))
    return total


def contacts(most: int = 0, *, stiffness: float = 0.0, thickness: float = 0.0) -> Contacts:
    """Room for `most` pairs, none in use."""
    return Contacts(
        np.zeros((most, 4), np.int64),
        np.zeros((most, 4)),
        np.zeros((most, 3)),
        np.zeros(most),
        np.zeros(1, np.int64),
        stiffness,
        thickness,
    )
