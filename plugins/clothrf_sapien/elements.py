"""Energy, gradient and Hessian of one implicit Euler step of the cloth, compiled.

The step from (x_n, v_n) over h minimises the incremental potential (Kane et al. 2000; Martin et al.
2011; Gast et al. 2015)

    E(x) =  sum m / (2 h^2) |x - y|^2                with y = x_n + h v_n + h^2 g
          + sum m c / (2 h) |x - x_n|^2              drag of the air
          + sum k / 2 (l - L)^2                      springs
          + sum taut k / 2 max(l - L_limit, 0)^2     threads pulled straight
          + sum b k / (2 h) (l - l_n)^2              damping of the springs
          + (1 + b / h) x.Kx / 2 - b / h x.K x_n     bending, damped
          + layers that touch                        see `contact`

Positions are (3, V) float64, one row a coordinate. A spring's Hessian is projected: under
compression the transverse part is dropped, so the matrix is always positive definite (Choi and Ko
2002).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from clothrf_sapien.contact import press, stiffen
from clothrf_sapien.stencil import hold


class Sheet(NamedTuple):
    """One cloth, as the kernels see it; see `Weave` for the first seven.

    Attributes:
        springs: (4, V) stiffness, N/m.
        lengths: (4,) rest lengths, m.
        limits: (4,) lengths beyond which a spring is taut, m.
        bending: (3, V) weights, N/m.
        mass: (V,) kg.
        numbers: (3,) damping time s, drag 1/s, taut stiffness over stretch stiffness.
        pins: (P,) pinned vertices.
        columns: C.
        ends: (4, 2) offsets in the vertex number of both ends of each family of springs.
    """

    springs: Any
    lengths: Any
    limits: Any
    bending: Any
    mass: Any
    numbers: Any
    pins: Any
    columns: Any
    ends: Any


class Past(NamedTuple):
    """What a step starts from.

    Attributes:
        x: (3, V) positions x_n, m.
        y: (3, V) inertial targets, m.
        lengths: (4, V) of the springs at x_n, m.
        bent: (3, V) K x_n, N.
        h: the step, s.
        contacts: `Contacts` between layers of the cloth.
    """

    x: Any
    y: Any
    lengths: Any
    bent: Any
    h: Any
    contacts: Any


# reassoc: sums are made in lanes; the result is the same from run to run.
@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def bend(x, sheet, out, moment):  # type: ignore[no-untyped-def]
    """(3, V) gradient K x of the bending energy x.Kx / 2, into `out`; `moment` is (V,) scratch."""
    num = x.shape[1]
    c = sheet.columns
    across, along, mixed = sheet.bending[0], sheet.bending[1], sheet.bending[2]
    out[:] = 0.0
    for i in range(3):
        xi, oi = x[i], out[i]
        if num > 2:
            n = num - 2
            weigh(moment, across[1:], xi, xi[1:], xi[2:], n)
            add(oi, 0, n, moment, 1.0)
            add(oi, 1, n, moment, -2.0)
            add(oi, 2, n, moment, 1.0)
        if num > 2 * c:
            n = num - 2 * c
            weigh(moment, along[c:], xi, xi[c:], xi[2 * c :], n)
            add(oi, 0, n, moment, 1.0)
            add(oi, c, n, moment, -2.0)
            add(oi, 2 * c, n, moment, 1.0)
        n = num - c - 1
        x1, x2, x3 = xi[1:], xi[c:], xi[c + 1 :]
        for a in range(n):
            moment[a] = mixed[a] * (xi[a] - x1[a] - x2[a] + x3[a])
        add(oi, 0, n, moment, 1.0)
        add(oi, 1, n, moment, -1.0)
        add(oi, c, n, moment, -1.0)
        add(oi, c + 1, n, moment, 1.0)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def add(out, offset, n, values, factor):  # type: ignore[no-untyped-def]
    """``out[offset + a] += factor * values[a]`` for n elements.

    Slices, not sums of indices: an index that might be negative cannot be vectorised.
    """
    part = out[offset : offset + n]
    for a in range(n):
        part[a] += factor * values[a]


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def weigh(out, weights, before, here, after, n):  # type: ignore[no-untyped-def]
    """Weighted second differences of n elements, into `out`."""
    for a in range(n):
        out[a] = weights[a] * (before[a] - 2.0 * here[a] + after[a])


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def measure(x, sheet, out):  # type: ignore[no-untyped-def]
    """(4, V) lengths of the springs, into `out`; of no meaning where there is no spring."""
    num = x.shape[1]
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        n = num - q
        size = out[f]
        x0, x1, x2 = x[0, p : p + n], x[1, p : p + n], x[2, p : p + n]
        y0, y1, y2 = x[0, q : q + n], x[1, q : q + n], x[2, q : q + n]
        for a in range(n):
            dx, dy, dz = y0[a] - x0[a], y1[a] - x1[a], y2[a] - x2[a]
            size[a] = np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def evaluate(x, sheet, past, g, springs, work):  # type: ignore[no-untyped-def]
    """E(x), its gradient, and what `assemble` needs to know about the springs.

    Many short loops over plain rows: each is small enough for LLVM to vectorise (51 us for a
    21 x 24 cloth when all of it stood in one loop a spring).

    Args:
        x: (3, V) positions.
        sheet: the cloth.
        past: what the step starts from.
        g: (3, V) gradient, overwritten; zero at pinned vertices.
        springs: (4, 5, V), overwritten: of every spring the unit direction (3), the length and the
            force, N.
        work: (4, V) scratch.

    Returns:
        E(x), J.
    """
    num = x.shape[1]
    h = past.h
    drag, taut = sheet.numbers[1], sheet.numbers[2]
    ratio = sheet.numbers[0] / h
    mass = sheet.mass
    total = 0.0
    bent = work[:3]
    bend(x, sheet, bent, work[3])
    for i in range(3):
        xi, yi, ni = x[i], past.y[i], past.x[i]
        gi, bi, wi = g[i], past.bent[i], bent[i]
        heavy, thick = 1.0 / (h * h), drag / h
        for a in range(num):
            from_y, from_n = xi[a] - yi[a], xi[a] - ni[a]
            total += 0.5 * mass[a] * (heavy * from_y * from_y + thick * from_n * from_n)
            total += xi[a] * (0.5 * (1.0 + ratio) * wi[a] - ratio * bi[a])
        for a in range(num):
            gi[a] = mass[a] * (heavy * (xi[a] - yi[a]) + thick * (xi[a] - ni[a]))
        for a in range(num):
            gi[a] += (1.0 + ratio) * wi[a] - ratio * bi[a]
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        n = num - q
        rest, limit = sheet.lengths[f], sheet.limits[f]
        k, was = sheet.springs[f], past.lengths[f]
        size, force = springs[f, 3], springs[f, 4]
        square = work[3]
        square[:] = 0.0
        for i in range(3):
            xp, xq, di = x[i, p : p + n], x[i, q : q + n], springs[f, i]
            for a in range(n):
                di[a] = xq[a] - xp[a]
            for a in range(n):
                square[a] += di[a] * di[a]
        for a in range(n):
            size[a] = max(np.sqrt(square[a]), 1e-12)
        for a in range(n):
            square[a] = 1.0 / size[a]
        for a in range(n):
            e, r, o = size[a] - rest, size[a] - was[a], max(size[a] - limit, 0.0)
            total += 0.5 * k[a] * (e * e + ratio * r * r + taut * o * o)
        for a in range(n):
            o = max(size[a] - limit, 0.0)
            force[a] = k[a] * (size[a] - rest + ratio * (size[a] - was[a]) + taut * o)
        for i in range(3):
            gp, gq, di = g[i, p : p + n], g[i, q : q + n], springs[f, i]
            for a in range(n):
                di[a] *= square[a]
            for a in range(n):
                gp[a] -= force[a] * di[a]
            for a in range(n):
                gq[a] += force[a] * di[a]
    total += press(x, past.contacts, g)
    for a in sheet.pins:
        g[0, a] = 0.0
        g[1, a] = 0.0
        g[2, a] = 0.0
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def constant_part(sheet, h, out):  # type: ignore[no-untyped-def]
    """What inertia, drag and bending add to the Hessian: one number for x, y and z alike.

    The bending's Hessian reaches two rows far, which would double the band; of each second
    difference across rows the entry that links row r - 1 with r + 1 is left out and added to both
    diagonal entries instead. That adds (x_{r-1} - x_{r+1})^2 to the quadratic model, never
    subtracts: the model stays above E, the gradient is exact.

    Args:
        sheet: the cloth.
        h: the step, s.
        out: (6, V), overwritten: the entries of vertex a with a + 0, 1, C, C + 1, C - 1, 2; the
            last is zero where one of both is pinned.
    """
    num = out.shape[1]
    columns, bending = sheet.columns, sheet.bending
    scale = 1.0 + sheet.numbers[0] / h
    out[:] = 0.0
    for a in range(num):
        out[0, a] += sheet.mass[a] * (1.0 / (h * h) + sheet.numbers[1] / h)
        w = bending[0, a] * scale
        if w != 0.0:
            out[0, a - 1] += w
            out[0, a] += 4.0 * w
            out[0, a + 1] += w
            out[1, a - 1] -= 2.0 * w
            out[1, a] -= 2.0 * w
            out[5, a - 1] += w
        w = bending[1, a] * scale
        if w != 0.0:
            out[0, a - columns] += 2.0 * w
            out[0, a] += 4.0 * w
            out[0, a + columns] += 2.0 * w
            out[2, a - columns] -= 2.0 * w
            out[2, a] -= 2.0 * w
        w = bending[2, a] * scale
        if w != 0.0:
            b = a + columns
            out[0, a] += w
            out[0, a + 1] += w
            out[0, b] += w
            out[0, b + 1] += w
            out[1, a] -= w
            out[1, b] -= w
            out[4, a + 1] += w
            out[2, a] -= w
            out[2, a + 1] -= w
            out[3, a] += w
    for a in sheet.pins:
        out[5, a] = 0.0
        if a >= 2:
            out[5, a - 2] = 0.0


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"}, error_model="numpy")
def hessian(springs, sheet, past, constant, work, out):  # type: ignore[no-untyped-def]
    """The projected Hessian, identity at pinned vertices, as a matrix of `stencil`.

    Its part that reaches two columns far is the last row of `constant`.

    Args:
        springs: as `evaluate` left it.
        sheet: the cloth.
        past: what the step starts from.
        constant: (6, V) as `constant_part` left it.
        work: (4, V) scratch.
        out: (5, 6, V), overwritten.
    """
    num = springs.shape[2]
    ratio, taut = sheet.numbers[0] / past.h, sheet.numbers[2]
    across, slope, block = work[0], work[1], work[2]
    own = out[0]
    own[:] = 0.0
    for entry in (0, 3, 5):
        own[entry] = constant[0]
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        n = num - q
        limit, k = sheet.limits[f], sheet.springs[f]
        size, force = springs[f, 3], springs[f, 4]
        for a in range(n):
            across[a] = max(force[a], 0.0) / size[a]
        for a in range(n):
            slope[a] = k[a] * (1.0 + ratio + (taut if size[a] > limit else 0.0)) - across[a]
        entry = 0
        for i in range(3):
            for j in range(i, 3):
                di, dj = springs[f, i], springs[f, j]
                target = out[1 + f, entry]
                target[:p] = 0.0
                target[p + n :] = 0.0
                target, fixed = target[p : p + n], constant[1 + f, p : p + n]
                here, there = own[entry, p : p + n], own[entry, q : q + n]
                if i == j:
                    for a in range(n):
                        block[a] = slope[a] * di[a] * di[a] + across[a]
                    for a in range(n):
                        target[a] = fixed[a] - block[a]
                else:
                    for a in range(n):
                        block[a] = slope[a] * di[a] * dj[a]
                    for a in range(n):
                        target[a] = -block[a]
                for a in range(n):
                    here[a] += block[a]
                for a in range(n):
                    there[a] += block[a]
                entry += 1
    stiffen(past.contacts, own)
    hold(out, sheet.pins, sheet.columns)
