"""Implicit Euler steps by Newton's method with a line search, one cloth or many a call."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from clothrf_sapien.banded import factor, solve
from clothrf_sapien.elements import Past, Sheet, bend, energy, hold, measure, start, stretch

GRAVITY = 9.81
ARMIJO = 1e-4


class Effort(NamedTuple):
    """How hard to try.

    Attributes:
        substeps: implicit Euler steps a control step.
        iterations: most Newton iterations a substep.
        tolerance: m; Newton stops when no vertex moved farther.
        half_width: of the band.
    """

    substeps: Any
    iterations: Any
    tolerance: Any
    half_width: Any


class Scratch(NamedTuple):
    """Memory that outlives no step: (V, 3) arrays, the band `A` and its right-hand side `b`."""

    A: Any
    b: Any
    g: Any
    trial: Any
    work: Any


@njit(cache=True, nogil=True, error_model="numpy")
def descend(x, sheet, past, pins, effort, scratch):  # type: ignore[no-untyped-def]
    """Minimise the incremental potential from `x` on, in place.

    Args:
        x: (V, 3) first guess, pinned vertices where they will be; replaced.
        sheet: the cloth.
        past: what the step starts from.
        pins: (P,) pinned vertices.
        effort: when to stop.
        scratch: memory.

    Returns:
        Newton iterations done.
    """
    A, b, g, trial, work = scratch.A, scratch.b, scratch.g, scratch.trial, scratch.work
    num = x.shape[0]
    n = 3 * num
    padded = -(-n // 4) * 4
    e = energy(x, sheet, past, work)
    done = 0
    for _ in range(effort.iterations):
        start(A, g, x, sheet, past, work)
        stretch(A, g, x, sheet, past)
        hold(A, g, pins, effort.half_width)
        factor(A, padded, effort.half_width)
        for a in range(num):
            for i in range(3):
                b[3 * a + i] = -g[a, i]
        b[n:] = 0.0
        solve(A, padded, effort.half_width, b)
        done += 1
        slope = 0.0
        longest = 0.0
        for a in range(num):
            move = 0.0
            for i in range(3):
                slope += g[a, i] * b[3 * a + i]
                move += b[3 * a + i] * b[3 * a + i]
            longest = max(longest, move)
        longest = np.sqrt(longest)
        if not (np.isfinite(longest) and slope < 0.0):
            break
        alpha = 1.0
        found = False
        for _ in range(20):
            for a in range(num):
                for i in range(3):
                    trial[a, i] = x[a, i] + alpha * b[3 * a + i]
            e_trial = energy(trial, sheet, past, work)
            if e_trial <= e + ARMIJO * alpha * slope + 1e-13:
                found = True
                break
            alpha *= 0.5
        if not found:
            break
        x[:] = trial
        e = e_trial
        if alpha * longest < effort.tolerance:
            break
    return done


@njit(cache=True, nogil=True, error_model="numpy")
def advance(x, v, pins, targets, sheets, ends, columns, dt, effort, A):  # type: ignore[no-untyped-def]
    """Step N cloths of equal topology, one after the other, without the interpreter's lock.

    Args:
        x: (N, V, 3) positions, replaced.
        v: (N, V, 3) velocities, replaced.
        pins: (P,) pinned vertices of each.
        targets: (N, P, 3) where they go, linearly over dt.
        sheets: springs (N, 4, V), lengths (N, 4), limits (N, 4), bending (N, 3, V), mass (N, V),
            numbers (N, 3) of each cloth's `Weave`.
        ends: (4, 2) see `Sheet`.
        columns: C.
        dt: seconds.
        effort: how hard to try.
        A: `band_shape` scratch, float32 or float64.

    Returns:
        Newton iterations done, of all cloths.
    """
    springs, lengths, limits, bending, mass, numbers = sheets
    count, num = x.shape[0], x.shape[1]
    h = dt / effort.substeps
    y, x_n, bent_n = np.empty((num, 3)), np.empty((num, 3)), np.empty((num, 3))
    l_n = np.zeros((4, num))
    scratch = Scratch(
        A,
        np.zeros(A.shape[0] + effort.half_width, A.dtype),
        np.empty((num, 3)),
        np.empty((num, 3)),
        np.empty((num, 3)),
    )
    past = Past(x_n, y, l_n, bent_n, h)
    begin = np.empty((len(pins), 3))
    done = 0
    for c in range(count):
        sheet = Sheet(
            springs[c], lengths[c], limits[c], bending[c], mass[c], numbers[c], columns, ends
        )
        xc, vc = x[c], v[c]
        for p in range(len(pins)):
            begin[p] = xc[pins[p]]
        for s in range(effort.substeps):
            measure(xc, sheet, l_n)
            bend(xc, sheet, bent_n)
            for a in range(num):
                for i in range(3):
                    x_n[a, i] = xc[a, i]
                    xc[a, i] += h * vc[a, i]
                    y[a, i] = xc[a, i]
                y[a, 2] -= h * h * GRAVITY
            t = (s + 1) / effort.substeps
            for p in range(len(pins)):
                for i in range(3):
                    goal = targets[c, p, i]
                    if s < effort.substeps - 1:
                        goal = begin[p, i] + t * (goal - begin[p, i])
                    xc[pins[p], i] = goal
            done += descend(xc, sheet, past, pins, effort, scratch)
            for a in range(num):
                for i in range(3):
                    vc[a, i] = (xc[a, i] - x_n[a, i]) / h
    return done
