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
        columns: C.
        ends: (4, 2) offsets in the vertex number of both ends of each family of springs.
    """

    springs: Any
    lengths: Any
    limits: Any
    bending: Any
    mass: Any
    numbers: Any
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
def energy(x, sheet, past, work):  # type: ignore[no-untyped-def]
    """E(x) of the module's docstring, J; `work` is (V, 3) scratch."""
    y, x_n, l_n, bent_n, h = past.y, past.x, past.lengths, past.bent, past.h
    damping, drag, taut = sheet.numbers[0], sheet.numbers[1], sheet.numbers[2]
    mass, springs = sheet.mass, sheet.springs
    num = x.shape[0]
    ratio = damping / h
    total = 0.0
    bend(x, sheet, work)
    for a in range(num):
        m = mass[a]
        s = 0.0
        d = 0.0
        b = 0.0
        for i in range(3):
            s += (x[a, i] - y[a, i]) ** 2
            d += (x[a, i] - x_n[a, i]) ** 2
            b += x[a, i] * (0.5 * (1.0 + ratio) * work[a, i] - ratio * bent_n[a, i])
        total += 0.5 * m / (h * h) * s + 0.5 * m * drag / h * d + b
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        length, limit = sheet.lengths[f], sheet.limits[f]
        for a in range(num):
            k = springs[f, a]
            if k == 0.0:
                continue
            dx = x[a + q, 0] - x[a + p, 0]
            dy = x[a + q, 1] - x[a + p, 1]
            dz = x[a + q, 2] - x[a + p, 2]
            size = np.sqrt(dx * dx + dy * dy + dz * dz)
            e = size - length
            r = size - l_n[f, a]
            o = max(size - limit, 0.0)
            total += 0.5 * k * (e * e + taut * o * o + ratio * r * r)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def start(A, g, x, sheet, past, work):  # type: ignore[no-untyped-def]
    """Inertia, drag and bending: the first terms of gradient and Hessian.

    The bending's Hessian reaches two rows far, which would double the band; of each second
    difference across rows the entry that links row r - 1 with r + 1 is left out and added to both
    diagonal entries instead. That adds (x_{r-1} - x_{r+1})^2 to the quadratic model, never
    subtracts: the model stays above E, the gradient is exact.

    Args:
        A: `band_shape` array, overwritten.
        g: (V, 3) gradient, overwritten.
        x: (V, 3) positions.
        sheet: the cloth.
        past: what the step starts from.
        work: (V, 3) scratch.
    """
    num = x.shape[0]
    y, x_n, bent_n, h = past.y, past.x, past.bent, past.h
    bending, mass, columns = sheet.bending, sheet.mass, sheet.columns
    drag = sheet.numbers[1]
    ratio = sheet.numbers[0] / h
    bend(x, sheet, work)
    A[:] = 0.0
    one = A.dtype.type(1.0)
    for j in range(3 * num, A.shape[0]):
        A[j, 0] = one
    for a in range(num):
        m = mass[a] / (h * h)
        d = mass[a] * drag / h
        for i in range(3):
            g[a, i] = (
                m * (x[a, i] - y[a, i])
                + d * (x[a, i] - x_n[a, i])
                + (1.0 + ratio) * work[a, i]
                - ratio * bent_n[a, i]
            )
            A[3 * a + i, 0] += m + d
    scale = 1.0 + ratio
    for a in range(num):
        w = bending[0, a] * scale
        if w != 0.0:
            for i in range(3):
                j = 3 * a + i
                A[j - 3, 0] += w
                A[j, 0] += 4.0 * w
                A[j + 3, 0] += w
                A[j - 3, 3] -= 2.0 * w
                A[j, 3] -= 2.0 * w
                A[j - 3, 6] += w
        w = bending[1, a] * scale
        if w != 0.0:
            o = 3 * columns
            for i in range(3):
                j = 3 * a + i
                A[j - o, 0] += 2.0 * w
                A[j, 0] += 4.0 * w
                A[j + o, 0] += 2.0 * w
                A[j - o, o] -= 2.0 * w
                A[j, o] -= 2.0 * w
        w = bending[2, a] * scale
        if w != 0.0:
            o = 3 * columns
            for i in range(3):
                j = 3 * a + i
                A[j, 0] += w
                A[j + 3, 0] += w
                A[j + o, 0] += w
                A[j + o + 3, 0] += w
                A[j, 3] -= w
                A[j, o] -= w
                A[j, o + 3] += w
                A[j + 3, o - 3] += w
                A[j + 3, o] -= w
                A[j + o, 3] -= w


@njit(cache=True, nogil=True, error_model="numpy")
def stretch(A, g, x, sheet, past):  # type: ignore[no-untyped-def]
    """Add the springs' forces to the gradient and their projected Hessian to the band."""
    num = x.shape[0]
    springs, l_n = sheet.springs, past.lengths
    taut = sheet.numbers[2]
    ratio = sheet.numbers[0] / past.h
    for f in range(4):
        p, q = sheet.ends[f, 0], sheet.ends[f, 1]
        o = 3 * (q - p)
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
            force = k * (size - length) + k * ratio * (size - l_n[f, a])
            slope = k * (1.0 + ratio)
            if size > limit:
                force += taut * k * (size - limit)
                slope += taut * k
            g[u, 0] -= force * dx
            g[u, 1] -= force * dy
            g[u, 2] -= force * dz
            g[v, 0] += force * dx
            g[v, 1] += force * dy
            g[v, 2] += force * dz
            across = max(force, 0.0) * inverse
            slope -= across
            sx, sy, sz = slope * dx, slope * dy, slope * dz
            xx, xy, xz = sx * dx + across, sx * dy, sx * dz
            yy, yz, zz = sy * dy + across, sy * dz, sz * dz + across
            for j in (3 * u, 3 * v):
                A[j, 0] += xx
                A[j, 1] += xy
                A[j, 2] += xz
                A[j + 1, 0] += yy
                A[j + 1, 1] += yz
                A[j + 2, 0] += zz
            j = 3 * u
            A[j, o] -= xx
            A[j, o + 1] -= xy
            A[j, o + 2] -= xz
            A[j + 1, o - 1] -= xy
            A[j + 1, o] -= yy
            A[j + 1, o + 1] -= yz
            A[j + 2, o - 2] -= xz
            A[j + 2, o - 1] -= yz
            A[j + 2, o] -= zz


@njit(cache=True, nogil=True, error_model="numpy")
def hold(A, g, pins, half_width):  # type: ignore[no-untyped-def]
    """Take the pinned vertices out of the unknowns: identity rows, no force."""
    one = A.dtype.type(1.0)
    zero = A.dtype.type(0.0)
    for a in pins:
        for j in range(3 * a, 3 * a + 3):
            for t in range(half_width + 1):
                A[j, t] = zero
            for t in range(1, min(half_width, j) + 1):
                A[j - t, t] = zero
            A[j, 0] = one
            g[a, j - 3 * a] = 0.0
