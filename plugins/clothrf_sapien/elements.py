"""Energy, gradient and Hessian of one implicit Euler step of the cloth, compiled.

The step from (x_n, v_n) over h minimises the incremental potential (Kane et al. 2000; Martin et al.
2011; Gast et al. 2015)

    E(x) =  sum m / (2 h^2) |x - y|^2                with y = x_n + h v_n + h^2 g
          + sum m c / (2 h) |x - x_n|^2              drag of the air
          + sum k / 2 (l - L)^2                      springs
          + sum taut k / 2 max(l - L_limit, 0)^2     threads pulled straight
          + sum b k / (2 h) (l - l_n)^2              damping of the springs
          + (1 + b / h) x.Kx / 2 - b / h x.K x_n     bending, damped

Positions are (V, 3) float64. A spring's Hessian is projected: under compression the transverse
part is dropped, so the matrix is always positive definite (Choi and Ko 2002).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit


class Sheet(NamedTuple):
    """One cloth, as the kernels see it; see `Weave` for the first seven.

    Attributes:
        springs: (4, V) stiffness, N/m.
        lengths: (4,) rest lengths, m.
        limits: (4,) lengths beyond which a spring is taut, m.
        bending: (3, V) weights, N/m.
        mass: (V,) kg.
        numbers: (3,) damping time s, drag 1/s, taut stiffness over stretch stiffness.
        free: (V,) bool, False where the vertex is pinned.
        columns: C.
        ends: (4, 2) offsets in the vertex number of both ends of each family of springs.
    """

    springs: Any
    lengths: Any
    limits: Any
    bending: Any
    mass: Any
    numbers: Any
    free: Any
    columns: Any
    ends: Any


class Past(NamedTuple):
    """What a step starts from.

    Attributes:
        x: (V, 3) positions x_n, m.
        y: (V, 3) inertial targets, m.
        lengths: (4, V) of the springs at x_n, m.
        bent: (V, 3) K x_n, N.
        h: the step, s.
    """

    x: Any
    y: Any
    lengths: Any
    bent: Any
    h: Any


@njit(cache=True, nogil=True, error_model="numpy")
def bend(x, sheet, out):  # type: ignore[no-untyped-def]
    """(V, 3) gradient K x of the bending energy x.Kx / 2, into `out`."""
    num = x.shape[0]
    bending, columns = sheet.bending, sheet.columns
    out[:] = 0.0
    for a in range(num):
        w = bending[0, a]
        if w != 0.0:
            for i in range(3):
                f = w * (x[a - 1, i] - 2.0 * x[a, i] + x[a + 1, i])
                out[a - 1, i] += f
                out[a, i] -= 2.0 * f
                out[a + 1, i] += f
        w = bending[1, a]
        if w != 0.0:
            b, c = a - columns, a + columns
            for i in range(3):
                f = w * (x[b, i] - 2.0 * x[a, i] + x[c, i])
                out[b, i] += f
                out[a, i] -= 2.0 * f
                out[c, i] += f
        w = bending[2, a]
        if w != 0.0:
            b = a + columns
            for i in range(3):
                f = w * (x[a, i] - x[a + 1, i] - x[b, i] + x[b + 1, i])
                out[a, i] += f
                out[a + 1, i] -= f
                out[b, i] -= f
                out[b + 1, i] += f


@njit(cache=True, nogil=True, error_model="numpy")
def measure(x, sheet, out):  # type: ignore[no-untyped-def]
    """(4, V) lengths of the springs, into `out`; untouched where there is none."""
    num = x.shape[0]
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        for a in range(num):
            if sheet.springs[f, a] != 0.0:
                dx = x[a + q, 0] - x[a + p, 0]
                dy = x[a + q, 1] - x[a + p, 1]
                dz = x[a + q, 2] - x[a + p, 2]
                out[f, a] = np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(x, sheet, past, g, local, work):  # type: ignore[no-untyped-def]
    """E(x), its gradient, and the springs' part of its projected Hessian.

    Args:
        x: (V, 3) positions.
        sheet: the cloth.
        past: what the step starts from.
        g: (V, 3) gradient, overwritten; zero at pinned vertices.
        local: (5, V, 6) float32, overwritten: xx, xy, xz, yy, yz, zz of every spring's block (four
            families) and, last, of every vertex' sum of the blocks of its springs.
        work: (V, 3) scratch.

    Returns:
        E(x), J.
    """
    num = x.shape[0]
    y, x_n, l_n, bent_n, h = past.y, past.x, past.lengths, past.bent, past.h
    damping, drag, taut = sheet.numbers[0], sheet.numbers[1], sheet.numbers[2]
    mass, springs = sheet.mass, sheet.springs
    ratio = damping / h
    total = 0.0
    bend(x, sheet, work)
    local[4] = 0.0
    for a in range(num):
        m = mass[a] / (h * h)
        d = mass[a] * drag / h
        for i in range(3):
            from_y = x[a, i] - y[a, i]
            from_n = x[a, i] - x_n[a, i]
            bent = (1.0 + ratio) * work[a, i]
            before = ratio * bent_n[a, i]
            total += 0.5 * (m * from_y * from_y + d * from_n * from_n)
            total += x[a, i] * (0.5 * bent - before)
            g[a, i] = m * from_y + d * from_n + bent - before
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        length, limit = sheet.lengths[f], sheet.limits[f]
        for a in range(num):
            k = springs[f, a]
            if k == 0.0:
                continue
            u, v = a + p, a + q
            dx = x[v, 0] - x[u, 0]
            dy = x[v, 1] - x[u, 1]
            dz = x[v, 2] - x[u, 2]
            size = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-12)
            inverse = 1.0 / size
            dx *= inverse
            dy *= inverse
            dz *= inverse
            e = size - length
            r = size - l_n[f, a]
            o = max(size - limit, 0.0)
            total += 0.5 * k * (e * e + ratio * r * r + taut * o * o)
            force = k * (e + ratio * r + taut * o)
            slope = k * (1.0 + ratio)
            if o > 0.0:
                slope += taut * k
            fx, fy, fz = force * dx, force * dy, force * dz
            g[u, 0] -= fx
            g[u, 1] -= fy
            g[u, 2] -= fz
            g[v, 0] += fx
            g[v, 1] += fy
            g[v, 2] += fz
            across = max(force, 0.0) * inverse
            slope -= across
            sx, sy, sz = slope * dx, slope * dy, slope * dz
            local[f, a, 0] = sx * dx + across
            local[f, a, 1] = sx * dy
            local[f, a, 2] = sx * dz
            local[f, a, 3] = sy * dy + across
            local[f, a, 4] = sy * dz
            local[f, a, 5] = sz * dz + across
            for i in range(6):
                local[4, u, i] += local[f, a, i]
                local[4, v, i] += local[f, a, i]
    for a in range(num):
        if not sheet.free[a]:
            g[a, 0] = 0.0
            g[a, 1] = 0.0
            g[a, 2] = 0.0
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
        out: (6, V), overwritten: the entries of vertex a with a + 0, 1, 2, C - 1, C, C + 1.
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
            out[2, a - 1] += w
        w = bending[1, a] * scale
        if w != 0.0:
            out[0, a - columns] += 2.0 * w
            out[0, a] += 4.0 * w
            out[0, a + columns] += 2.0 * w
            out[4, a - columns] -= 2.0 * w
            out[4, a] -= 2.0 * w
        w = bending[2, a] * scale
        if w != 0.0:
            b = a + columns
            out[0, a] += w
            out[0, a + 1] += w
            out[0, b] += w
            out[0, b + 1] += w
            out[1, a] -= w
            out[1, b] -= w
            out[3, a + 1] += w
            out[4, a] -= w
            out[4, a + 1] -= w
            out[5, a] += w


@njit(cache=True, nogil=True, error_model="numpy")
def assemble(A, S, local, constant, sheet):  # type: ignore[no-untyped-def]
    """The projected Hessian in the layout of `banded`; identity at pinned vertices.

    Args:
        A: flat float32, overwritten.
        S: floats a column.
        local: as `evaluate` left it.
        constant: as `constant_part` left it.
        sheet: the cloth.
    """
    num = constant.shape[1]
    free = sheet.free
    A[:] = 0.0
    for j in range(3 * num, len(A) // S):
        A[j * S + (j & 7)] = 1.0
    for a in range(num):
        j0 = 3 * a * S + (3 * a & 7)
        j1 = (3 * a + 1) * S + (3 * a + 1 & 7) - 1
        j2 = (3 * a + 2) * S + (3 * a + 2 & 7) - 2
        if not free[a]:
            A[j0] = 1.0
            A[j1 + 1] = 1.0
            A[j2 + 2] = 1.0
            continue
        own = local[4, a]
        c = constant[0, a]
        A[j0] = own[0] + c
        A[j0 + 1] = own[1]
        A[j0 + 2] = own[2]
        A[j1 + 1] = own[3] + c
        A[j1 + 2] = own[4]
        A[j2 + 2] = own[5] + c
        if a + 2 < num and free[a + 2]:
            c = constant[2, a]
            A[j0 + 6] += c
            A[j1 + 7] += c
            A[j2 + 8] += c
        for f in range(4):
            q = sheet.ends[f, 1] - sheet.ends[f, 0]
            at = a - sheet.ends[f, 0]
            if at < 0 or a + q >= num or not free[a + q]:
                continue
            block = local[f, at]
            c = constant[1 if f == 0 else (4 if f == 1 else (5 if f == 2 else 3)), a]
            o = 3 * q
            A[j0 + o] += c - block[0]
            A[j0 + o + 1] -= block[1]
            A[j0 + o + 2] -= block[2]
            A[j1 + o] -= block[1]
            A[j1 + o + 1] += c - block[3]
            A[j1 + o + 2] -= block[4]
            A[j2 + o] -= block[2]
            A[j2 + o + 1] -= block[4]
            A[j2 + o + 2] += c - block[5]
