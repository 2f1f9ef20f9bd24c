"""The comparisons of `checks` over all joints, compiled: numbers in, first bad one out.

Each function gives -1 when everything is allowed. Comparisons are written so that NaN fails. The
signatures are fixed, so that everything is compiled when the module is imported and nothing is
while arms move; an array of another kind is a TypeError, which for the bridge is a refusal.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

GOOD = -1


@njit("i8(f8[::1], f8[::1], f8[::1], f8, f8[:, ::1])", cache=True, nogil=True)
def bad_command(q: Any, qd: Any, before: Any, window_s: Any, limits: Any) -> Any:
    """Row * J + joint of the first number that may not be commanded.

    Rows: 0 position, 1 velocity, 2 step since `before` (J,), at full speed for `window_s`.
    `limits`: (3, J) lower, upper, velocity.
    """
    joints = q.size
    for j in range(joints):
        if not limits[0, j] <= q[j] <= limits[1, j]:
            return j
    for j in range(joints):
        if not abs(qd[j]) <= limits[2, j]:
            return joints + j
    for j in range(joints):
        if not abs(q[j] - before[j]) <= limits[2, j] * window_s:
            return 2 * joints + j
    return GOOD


@njit("i8(f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[:, ::1])", cache=True, nogil=True)
def bad_motion(q0: Any, v0: Any, q: Any, v: Any, a: Any, limits: Any) -> Any:
    """Row * J + joint of the first number of an output that the joints cannot or may not do.

    Rows: 0 position, 1 speed, 2 step since `q0`, 3 acceleration, 4 speed step since `v0`.
    `limits`: (6, J) lower, upper, then the greatest magnitude of rows 1 to 4.
    """
    joints = q.size
    for j in range(joints):
        if not limits[0, j] <= q[j] <= limits[1, j]:
            return j
    for j in range(joints):
        if not abs(v[j]) <= limits[2, j]:
            return joints + j
    for j in range(joints):
        if not abs(q[j] - q0[j]) <= limits[3, j]:
            return 2 * joints + j
    for j in range(joints):
        if not abs(a[j]) <= limits[4, j]:
            return 3 * joints + j
    for j in range(joints):
        if not abs(v[j] - v0[j]) <= limits[5, j]:
            return 4 * joints + j
    return GOOD


@njit("i8(f8[::1], f8[::1], f8)", cache=True, nogil=True)
def far_apart(one: Any, other: Any, most: Any) -> Any:
    """The first joint in which two postures differ by more than `most`."""
    for j in range(one.size):
        if not abs(one[j] - other[j]) <= most:
            return j
    return GOOD


@njit("i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8)", cache=True, nogil=True)
def bad_grippers(points: Any, before: Any, box: Any, step: Any) -> Any:
    """The first gripper i outside `box` (2, 3), or N + i for one that moved farther than `step`."""
    for i in range(points.shape[0]):
        square = 0.0
        for k in range(3):
            if not box[0, k] <= points[i, k] <= box[1, k]:
                return i
            square += (points[i, k] - before[i, k]) ** 2
        if not math.sqrt(square) <= step:
            return points.shape[0] + i
    return GOOD


@njit("f8(f8, f8[:, ::1], i8)", cache=True, nogil=True)
def half_stop(v: Any, s_curve: Any, j: Any) -> Any:
    """Half of the seconds in which joint `j` comes to rest from speed `v` >= 0.

    `s_curve`: (4, J) a^2/j, 1/(2 a), a/(2 j), 1/j of each joint.
    """
    if v > s_curve[0, j]:
        return v * s_curve[1, j] + s_curve[2, j]
    return math.sqrt(v * s_curve[3, j])


@njit("void(f8[::1], f8[::1], f8[::1], f8[:, ::1], f8, f8, f8, f8[:, ::1])", cache=True, nogil=True)
def walk(
    pursued: Any, q: Any, qd: Any, s_curve: Any, quick: Any, creep: Any, pause: Any, out: Any
) -> None:
    """See `checks.pursue`; `out` (2, J) becomes the pursued posture and what to head for."""
    for j in range(q.size):
        v = abs(qd[j])
        reach = max(quick * v, creep)
        way = q[j] - pursued[j]
        ahead = qd[j] * half_stop(v, s_curve, j)
        if abs(way) <= reach:
            out[0, j] = q[j]
        else:
            out[0, j] = pursued[j] + math.copysign(reach, way)
            left = abs(q[j] - out[0, j]) / (pause * reach)
            ahead *= min(max(1.5 - left, 0.0), 1.0)
        out[1, j] = out[0, j] + ahead


@njit("void(f8[::1], f8[::1], f8[::1], f8[:, ::1], f8[::1])", cache=True, nogil=True)
def rest(q: Any, qd: Any, qdd: Any, s_curve: Any, out: Any) -> None:
    """See `checks.stopping_point`; `out` (J,) becomes where the joints come to rest."""
    for j in range(q.size):
        sign = 0.0 if qd[j] == 0.0 else math.copysign(1.0, qd[j])
        gain = max(sign * qdd[j], 0.0)
        release = gain * s_curve[3, j]
        v = abs(qd[j]) + 0.5 * gain * release
        out[j] = q[j] + sign * v * (release + half_stop(v, s_curve, j))
