"""Sheets whose shape is known: what the benchmark and the tests hold the cloth against."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, trapezoid
from scipy.optimize import brentq

from clothrf_core.params import Fabric, SimulationParams
from clothrf_core.types import Float
from clothrf_sapien.cloth import Cloths
from clothrf_sapien.weave import GRAVITY, Weave, weave

STEP = 1.0 / 30.0


def catenary(length: float, distance: float) -> tuple[float, float]:
    """Parameter a and sag of a chain of `length` between level points `distance` apart, metres.

    ``z = a cosh(x / a)`` with ``2 a sinh(distance / 2 a) = length``.
    """
    ratio = length / distance
    t = brentq(lambda t: np.sinh(t) / t - ratio, 1e-6, 50.0)
    a = distance / (2.0 * t)
    return a, a * (np.cosh(t) - 1.0)


def catenary_error(*, resolution: tuple[int, int] = (21, 24), distance: float = 0.25) -> float:
    """Largest height error of a sheet hung from two opposite edges, over its length.

    The sheet is nearly inextensible and limp; vertices of the middle column are compared.
    """
    size = (0.30, 0.35)
    fabric = Fabric(stretch_warp=2e4, stretch_weft=2e4, shear=10.0, bending=1e-8)
    w = _weave(fabric, size, resolution)
    rest = w.mesh.rest
    held = np.flatnonzero((rest[:, 1] == 0.0) | (rest[:, 1] == size[1]))
    a, sag = catenary(size[1], distance)
    # Begin at half the sag, where every thread is too short: it has to find the shape itself.
    s = rest[:, 1] / size[1]
    start = np.stack([distance * s, rest[:, 0], -2.0 * sag * s * (1.0 - s)], axis=1)
    x = settled(w, start, held, steps=240)
    middle = np.abs(rest[:, 0] - rest[np.argmin(np.abs(rest[:, 0] - size[0] / 2)), 0]) < 1e-9
    truth = a * (np.cosh((x[middle, 0] - distance / 2) / a) - 1.0) - sag
    return float(np.abs(x[middle, 2] - truth).max() / size[1])


def elastica_angle(bending: float, weight: float, length: float) -> float:
    """Angle below the horizontal of the chord from clamp to tip of a heavy strip, radians.

    ``B t'' + w (l - s) cos t = 0`` with ``t(0) = 0, t'(l) = 0`` for the slope t, positive
    downwards: the strip that Peirce (1930) fits by ``c = l (cos(a/2) / (8 tan a))^(1/3)``.

    Args:
        bending: B, N m.
        weight: w, N/m^2.
        length: l, metres.
    """

    def ends(at_clamp: Float, at_tip: Float) -> Float:
        return np.array([at_clamp[0], at_tip[1]])

    s = np.linspace(0.0, length, 201)
    guess = np.zeros((2, len(s)))
    load = weight * length**3 / bending
    for part in np.linspace(min(1.0, 1.0 / load), 1.0, 12):
        answer = solve_bvp(
            lambda s, t, part=part: np.stack(
                [t[1], -part * weight * (length - s) * np.cos(t[0]) / bending]
            ),
            ends,
            s,
            guess,
            tol=1e-8,
            max_nodes=20000,
        )
        s, guess = answer.x, answer.y
    x = trapezoid(np.cos(guess[0]), s)
    z = trapezoid(np.sin(guess[0]), s)
    return float(np.arctan2(z, x))


def cantilever_error(*, resolution: tuple[int, int] = (8, 24), bending: float = 1e-3) -> float:
    """Relative error of the bending length that a strip under its own weight shows.

    The strip overhangs twice its bending length ``c = (B / w)^(1/3)``, as in Peirce's test; the
    bending length whose elastica hangs at the same angle is compared. Two rows are held: they fix
    the slope half-way between them, where the overhang begins.
    """
    fabric = Fabric(stretch_warp=5e3, stretch_weft=5e3, shear=1e3, bending=bending)
    weight = fabric.density * GRAVITY
    own = (bending / weight) ** (1.0 / 3.0)
    rows = resolution[1]
    cell = 2.0 * own / (rows - 1.5)
    w = _weave(fabric, (cell * (resolution[0] - 1), cell * (rows - 1)), resolution)
    rest = w.mesh.rest
    held = np.flatnonzero(rest[:, 1] < 1.5 * cell)
    start = np.stack([rest[:, 1] - cell, rest[:, 0], np.zeros(len(rest))], axis=1)
    x = settled(w, start, held, steps=300)
    tip = x[rest[:, 1] > rest[:, 1].max() - 0.5 * cell].mean(axis=0)
    angle = float(np.arctan2(-tip[2], tip[0]))
    length = 2.0 * own
    shown = brentq(
        lambda c: elastica_angle(weight * c**3, weight, length) - angle, 0.6 * own, 1.6 * own
    )
    return float(abs(shown / own - 1.0))


def hanging_elongation(stretch: float, *, resolution: tuple[int, int] = (21, 24)) -> float:
    """Elongation of a sheet hung from its top edge over the analytic ``rho g L^2 / (2 E)``."""
    size = (0.30, 0.35)
    fabric = Fabric(stretch_warp=stretch, stretch_weft=stretch, shear=0.1 * stretch)
    w = _weave(fabric, size, resolution)
    rest = w.mesh.rest
    start = np.stack([np.zeros(len(rest)), rest[:, 0], -rest[:, 1]], axis=1)
    x = settled(w, start, np.flatnonzero(rest[:, 1] == 0.0), steps=240)
    lowest = -x[rest[:, 1] == size[1], 2].mean() - size[1]
    return float(lowest / (fabric.density * GRAVITY * size[1] ** 2 / (2.0 * stretch)))


def settled(w: Weave, start: Float, held: NDArray[np.intp], *, steps: int) -> Float:
    """(V, 3) vertices after `steps` steps in thick air with the vertices `held` where they are."""
    cloths = Cloths([w], start[None], held.astype(np.int64))
    for _ in range(steps):
        cloths.advance(
            start[held][None],
            STEP,
            substeps=1,
            iterations=100,
            tolerance=1e-5,
            extra_drag=2.0,
        )
    result: Float = cloths.x[0]
    return result


def _weave(fabric: Fabric, size: tuple[float, float], resolution: tuple[int, int]) -> Weave:
    nowhere = np.zeros((2, 3))
    params = SimulationParams(hands=nowhere, grasp=nowhere, size=size, resolution=resolution)
    return weave(replace(params, fabric=fabric), strain_limit=0.0, taut=0.0)
