"""Implicit Euler steps: the incremental potential minimised by Newton's method, compiled.

Every Newton step factors the projected Hessian anew and is checked by a line search, so the
potential never rises. Done is when no vertex moved farther than the tolerance, or when the whole
sheet moved less than that in the norm of the Hessian over its inertia, which counts a strain
thousands of times: single vertices of a wrinkle may creep on (factors a step 1.63 to 1.54, 4.43 to
4.09 under a learner; 0.41 mm RMS from the converged step instead of 0.36).

Measured on a 21 x 24 cloth in the tasks: 1.2 to 2.2 factors and one evaluation more a control
step. Reusing a factor for the next steps, as the seed of a quasi-Newton method (L-BFGS, memory 3
to 10) or as a preconditioner (5 to 8 conjugate gradient steps), saved nothing: the springs turn too
far. Nor did the full bending Hessian, at four times the price of a factor, longer steps where the
slope remains, or conjugate Newton directions (1.81 to 1.76 factors).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from clothrf_sapien.contact import MOST, TIGHTER, Contacts, find
from clothrf_sapien.elements import (
    Past,
    Sheet,
    bend,
    constant_part,
    evaluate,
    hessian,
    measure,
)
from clothrf_sapien.schwarz import direction

GRAVITY = 9.81
ARMIJO = 1e-4
SHARE = 0.2
FINEST = 1e-5
"""m; a last move may be this share of the step's whole travel, but need not be finer than that:
1 mm a step is 30 mm/s, and with a fixed tolerance of 1 mm hung cloth never came to rest."""
CARRIED = 0.8
"""Share of the velocity that the first guess of a step trusts. Measured from 1.0 to 0.8: factors a
step 1.69 to 1.63 in smooth motion, 4.85 to 4.43 where a learner jerks the corners, and hung
cloth ends at 4e-12 mm/s, not at 0.09."""
ROUND_OFF = 1e-13
"""J; differences of the potential below this mean nothing."""


class Effort(NamedTuple):
    """How hard to try.

    Attributes:
        substeps: implicit Euler steps a control step.
        iterations: most Newton steps a substep.
        tolerance: m; done when no vertex moved farther.
    """

    substeps: Any
    iterations: Any
    tolerance: Any


class Scratch(NamedTuple):
    """Memory whose contents outlive no step; kept, because new memory cost 45 us a call.

    Attributes:
        here: (3, V) positions.
        x: (3, V), y: (3, V), lengths: (4, V), bent: (3, V) of `Past`.
        p: (3, V) step.
        g: (3, V) gradient.
        trial: (3, V) positions.
        work: (4, V).
        springs: (4, 5, V) of `evaluate`.
        matrix: (5, 6, V) of `hessian`.
        constant: (6, V) of `constant_part`.
        pairs: (K, 4), weights: (K, 4), normals: (K, 3), depth: (K,), used: (1,) of `Contacts`.
    """

    here: Any
    x: Any
    y: Any
    lengths: Any
    bent: Any
    p: Any
    g: Any
    trial: Any
    work: Any
    springs: Any
    matrix: Any
    constant: Any
    pairs: Any
    weights: Any
    normals: Any
    depth: Any
    used: Any


def scratch_for(num: int, *, layered: bool) -> Scratch:
    """Memory to step cloths of V vertices, some of them with self-contact or none."""
    most = MOST * num if layered else 0
    many: list[Any] = [(3, num)] * 3 + [(4, num)] + [(3, num)] * 4 + [(4, num)]
    many += [(4, 5, num), (5, 6, num), (6, num)]
    pairs = np.zeros((most, 4), np.int64)
    contacts = [pairs, np.zeros((most, 4)), np.zeros((most, 3)), np.zeros(most)]
    return Scratch._make([np.zeros(shape) for shape in many] + [*contacts, np.zeros(1, np.int64)])


@njit(cache=True, nogil=True, error_model="numpy")
def descend(x, sheet, past, effort, plan, scratch):  # type: ignore[no-untyped-def]
    """Minimise the incremental potential from `x` on, in place.

    Args:
        x: (3, V) first guess, pinned vertices where they will be; replaced.
        sheet: the cloth.
        past: what the step starts from.
        effort: when to stop.
        plan: how the grid is solved.
        scratch: memory.

    Returns:
        Evaluations of the potential and factors made.
    """
    p, g, trial = scratch.p, scratch.g, scratch.trial
    num = x.shape[1]
    tolerance = effort.tolerance
    if past.contacts.stiffness > 0.0:
        tolerance *= TIGHTER
    e = evaluate(x, sheet, past, g, scratch.springs, scratch.work)
    evaluations = 1
    factors = 0
    inertia = sheet.mass.sum() / (past.h * past.h)
    for _ in range(effort.iterations):
        hessian(scratch.springs, sheet, past, scratch.constant, scratch.work, scratch.matrix)
        direction(scratch.matrix, scratch.constant[5], g, sheet.pins, plan, p)
        factors += 1
        slope = 0.0
        longest = 0.0
        for a in range(num):
            px, py, pz = p[0, a], p[1, a], p[2, a]
            slope += g[0, a] * px + g[1, a] * py + g[2, a] * pz
            longest = max(longest, px * px + py * py + pz * pz)
        longest = np.sqrt(longest)
        if not (np.isfinite(longest) and slope < 0.0):
            break
        alpha = 1.0
        found = False
        for _ in range(20):
            for i in range(3):
                for a in range(num):
                    trial[i, a] = x[i, a] + alpha * p[i, a]
            e_trial = evaluate(trial, sheet, past, g, scratch.springs, scratch.work)
            evaluations += 1
            if e_trial <= e + ARMIJO * alpha * slope + ROUND_OFF:
                found = True
                break
            # The parabola through both energies and the slope, kept within a tenth and a half.
            best = -0.5 * slope * alpha / ((e_trial - e) / alpha - slope)
            alpha = min(max(best, 0.1 * alpha), 0.5 * alpha)
        if not found:
            break
        x[:] = trial
        e = e_trial
        travel = 0.0
        for a in range(num):
            d = 0.0
            for i in range(3):
                d += (x[i, a] - past.x[i, a]) ** 2
            travel = max(travel, d)
        near = min(tolerance, max(SHARE * np.sqrt(travel), FINEST))
        if alpha * longest < near or -slope < inertia * near * near:
            break
    return evaluations, factors


@njit(cache=True, nogil=True, error_model="numpy")
def advance(  # type: ignore[no-untyped-def]
    x, v, pins, targets, sheets, ends, columns, triangles, lift, dt, effort, plan, scratch, tally
):
    """Step N cloths of equal topology, one after the other, without the interpreter's lock.

    Args:
        x: (N, V, 3) positions, replaced.
        v: (N, V, 3) velocities, replaced.
        pins: (P,) pinned vertices of each.
        targets: (N, P, 3) where they go, linearly over dt.
        sheets: springs (N, 4, V), lengths (N, 4), limits (N, 4), bending (N, 3, V), mass (N, V),
            numbers (N, 3) of each cloth's `Weave`, layers (N, 2) stiffness and thickness of its
            self-contact.
        ends: (4, 2) see `Sheet`.
        columns: C.
        triangles: (M, 3) of the mesh.
        lift: (P, V) how much of a pinned vertex' unforeseen move the others are guessed to make.
        dt: seconds.
        effort: how hard to try.
        plan: how the grid is solved, with its memory.
        scratch: of `scratch_for`, with room for contacts if any cloth has layers.
        tally: (N, 2) gets the evaluations and factors of each cloth.
    """
    springs, lengths, limits, bending, mass, numbers, layers = sheets
    count, num = x.shape[0], x.shape[1]
    h = dt / effort.substeps
    here = scratch.here
    begin = np.empty((len(pins), 3))
    goals = np.empty((len(pins), 3))
    for c in range(count):
        sheet = Sheet(
            springs[c], lengths[c], limits[c], bending[c], mass[c], numbers[c], pins, columns, ends,
        )  # fmt: skip
        touching = Contacts(
            scratch.pairs, scratch.weights, scratch.normals, scratch.depth, scratch.used,
            layers[c, 0], layers[c, 1],
        )  # fmt: skip
        past = Past(scratch.x, scratch.y, scratch.lengths, scratch.bent, h, touching)
        constant_part(sheet, h, scratch.constant)
        xc, vc = x[c], v[c]
        for p in range(len(pins)):
            begin[p] = xc[pins[p]]
        for s in range(effort.substeps):
            for a in range(num):
                for i in range(3):
                    past.x[i, a] = xc[a, i]
                    here[i, a] = xc[a, i] + CARRIED * h * vc[a, i]
                    past.y[i, a] = xc[a, i] + h * vc[a, i]
                past.y[2, a] -= h * h * GRAVITY
            measure(past.x, sheet, past.lengths)
            bend(past.x, sheet, past.bent, scratch.work[0])
            t = (s + 1) / effort.substeps
            for p in range(len(pins)):
                for i in range(3):
                    goal = targets[c, p, i]
                    if s < effort.substeps - 1:
                        goal = begin[p, i] + t * (goal - begin[p, i])
                    goals[p, i] = goal
            for p in range(len(pins)):
                for i in range(3):
                    sudden = goals[p, i] - xc[pins[p], i] - CARRIED * h * vc[pins[p], i]
                    for a in range(num):
                        here[i, a] += lift[p, a] * sudden
            for p in range(len(pins)):
                for i in range(3):
                    here[i, pins[p]] = goals[p, i]
            find(past.x, here, triangles, columns, touching)
            evaluations, factors = descend(here, sheet, past, effort, plan, scratch)
            tally[c, 0] += evaluations
            tally[c, 1] += factors
            for a in range(num):
                for i in range(3):
                    xc[a, i] = here[i, a]
                    vc[a, i] = (here[i, a] - past.x[i, a]) / h
