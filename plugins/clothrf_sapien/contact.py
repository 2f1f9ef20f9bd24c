"""Self-contact: layers of cloth are kept apart by one-sided springs, compiled.

At the start of a step every vertex is paired with the triangles it may meet during the step; the
side it is on, the foot of its perpendicular and the direction are kept for the step. A pair that
comes nearer than the thickness t pushes with the energy ``k / 2 (t - n.(x_v - foot))^2``. As the
side is decided before anything moves, a layer does not tunnel through another in one step.

The Hessian of a pair links vertices that may be far apart in the grid, which the band cannot hold.
With the weights c = (1, -w1, -w2, -w3), ``c c^T <= |c|_1 diag(|c|)``: the diagonal on the right is
used, so the quadratic model still lies above the energy.

Not yet trustworthy in fast folds. Edges that meet edges are not looked for, and layers that have
crossed once are held crossed, which strains the cloth. Measured on the twisted task, edges that
cross a triangle, a frame (of 983), without and with contact: 12 and 1 over 100 steps, 12 and 10
over 300, at six times the price. A cloth hung into a twist unfolds without any (16 without
contact). The diagonal bound makes Newton's method slow, hence `TIGHTER`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

TIGHTER = 0.1
"""Newton's tolerance with contact, over that without: at 1 mm layers slip through."""
MOST = 8
"""Pairs kept, for each vertex of the cloth."""
NEAREST, FARTHEST = 0.005, 0.03
"""m; layers are looked for at least and at most this far beyond the thickness."""


class Contacts(NamedTuple):
    """Pairs of a vertex and a triangle.

    Attributes:
        pairs: (K, 4) vertex and corners of the triangle.
        weights: (K, 4) of x_v - foot: 1 and minus the foot's barycentric coordinates.
        normals: (K, 3) unit vectors from the triangle to the vertex' side.
        depth: (K,) thickness minus distance where `press` looked last, m.
        count: (1,) pairs in use.
        stiffness: k, N/m; 0 = no contact.
        thickness: t, m.
    """

    pairs: Any
    weights: Any
    normals: Any
    depth: Any
    count: Any
    stiffness: Any
    thickness: Any


@njit(cache=True, nogil=True, error_model="numpy")
def find(x, x_next, triangles, columns, contacts):  # type: ignore[no-untyped-def]
    """Fill `contacts` with the pairs that may touch between `x` and `x_next`, both (3, V)."""
    num = x.shape[1]
    contacts.count[0] = 0
    if contacts.stiffness == 0.0:
        return
    longest = 0.0
    for a in range(num):
        d = 0.0
        for i in range(3):
            d += (x_next[i, a] - x[i, a]) ** 2
        longest = max(longest, d)
    reach = contacts.thickness + min(max(2.0 * np.sqrt(longest), NEAREST), FARTHEST)
    for t in range(len(triangles)):
        ia, ib, ic = triangles[t]
        ax, ay, az = x[0, ia], x[1, ia], x[2, ia]
        ux, uy, uz = x[0, ib] - ax, x[1, ib] - ay, x[2, ib] - az
        vx, vy, vz = x[0, ic] - ax, x[1, ic] - ay, x[2, ic] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        size = np.sqrt(nx * nx + ny * ny + nz * nz)
        if size < 1e-12:
            continue
        nx /= size
        ny /= size
        nz /= size
        uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, 0.0
        vv = vx * vx + vy * vy + vz * vz
        bound = reach + np.sqrt(max(uu, vv))
        determinant = uu * vv - uv * uv
        row, column = ia // columns, ia % columns
        for a in range(num):
            dx, dy, dz = x[0, a] - ax, x[1, a] - ay, x[2, a] - az
            if dx * dx + dy * dy + dz * dz > bound * bound:
                continue
            height = nx * dx + ny * dy + nz * dz
            if abs(height) > reach:
                continue
            if abs(a // columns - row) <= 2 and abs(a % columns - column) <= 2:
                continue
            du, dv = dx * ux + dy * uy + dz * uz, dx * vx + dy * vy + dz * vz
            wb = (vv * du - uv * dv) / determinant
            wc = (uu * dv - uv * du) / determinant
            if wb < -0.1 or wc < -0.1 or wb + wc > 1.1:
                continue
            k = contacts.count[0]
            if k >= len(contacts.depth):
                return
            contacts.count[0] = k + 1
            wb, wc = max(wb, 0.0), max(wc, 0.0)
            total = max(wb + wc, 1.0)
            wb, wc = wb / total, wc / total
            contacts.pairs[k, 0] = a
            contacts.pairs[k, 1] = ia
            contacts.pairs[k, 2] = ib
            contacts.pairs[k, 3] = ic
            contacts.weights[k, 0] = 1.0
            contacts.weights[k, 1] = wb + wc - 1.0
            contacts.weights[k, 2] = -wb
            contacts.weights[k, 3] = -wc
            side = 1.0 if height >= 0.0 else -1.0
            contacts.normals[k, 0] = side * nx
            contacts.normals[k, 1] = side * ny
            contacts.normals[k, 2] = side * nz


@njit(cache=True, nogil=True, error_model="numpy")
def press(x, contacts, g):  # type: ignore[no-untyped-def]
    """Energy of the pairs nearer than the thickness, J; their forces are added to (3, V) `g`."""
    total = 0.0
    for k in range(contacts.count[0]):
        distance = 0.0
        for c in range(4):
            a, w = contacts.pairs[k, c], contacts.weights[k, c]
            for i in range(3):
                distance += w * contacts.normals[k, i] * x[i, a]
        depth = contacts.thickness - distance
        contacts.depth[k] = depth
        if depth > 0.0:
            total += 0.5 * contacts.stiffness * depth * depth
            force = contacts.stiffness * depth
            for c in range(4):
                a, w = contacts.pairs[k, c], contacts.weights[k, c]
                for i in range(3):
                    g[i, a] -= force * w * contacts.normals[k, i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def stiffen(contacts, own):  # type: ignore[no-untyped-def]
    """Add the diagonal bound of the pairs' Hessian to the (6, V) own blocks of the vertices."""
    for k in range(contacts.count[0]):
        if contacts.depth[k] <= 0.0:
            continue
        total = 0.0
        for c in range(4):
            total += abs(contacts.weights[k, c])
        for c in range(4):
            a = contacts.pairs[k, c]
            s = contacts.stiffness * total * abs(contacts.weights[k, c])
            entry = 0
            for i in range(3):
                for j in range(i, 3):
                    own[entry, a] += s * contacts.normals[k, i] * contacts.normals[k, j]
                    entry += 1
