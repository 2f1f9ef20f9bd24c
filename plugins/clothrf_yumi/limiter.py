"""Ruckig between a target that may jump and a joint that may not.

Only position targets at rest: with a target speed of zero, Ruckig's community version never leaves
the interval that its targets come from; with any other it does. `intermediate_positions` is never
set: the community version would send them to a server.
"""

from __future__ import annotations

import numpy as np
import ruckig
from typing_extensions import override

from clothrf_core.errors import RefusedTarget
from clothrf_core.interfaces import JointLimiter
from clothrf_core.types import Float
from clothrf_yumi.compiled import NEW, settle
from clothrf_yumi.limits import Limits

# Ruckig keeps its bounds up to rounding; ours are kept exactly because its are this much tighter.
ROUNDING = 1e-9


class RuckigLimiter(JointLimiter):
    """Time-optimal motion of every joint by itself (no synchronisation adds no lag).

    Berscheid and Kroeger, "Jerk-limited real-time trajectory generation with arbitrary target
    states", RSS 2021.

    Args:
        limits: bounds of every tick.
        dt: period of the ticks, seconds.
        q: (J,) posture at rest to start from. Between a soft and a hard limit is allowed: the
            first target leads back inside.

    Raises:
        RefusedTarget: `q` is not finite, of the wrong length or outside the hard limits.
    """

    def __init__(self, limits: Limits, dt: float, *, q: Float) -> None:
        joints = limits.lower.size
        start = _shaped("q", q, joints)
        if not np.isfinite(start).all():
            raise _not_finite("q", start, int(np.argmin(np.isfinite(start))))
        if np.any(start < limits.lower) or np.any(start > limits.upper):
            j = int(np.argmax(np.maximum(limits.lower - start, start - limits.upper)))
            raise RefusedTarget(
                f"limiter: expected a start within the joint limits, got {start[j]:.4f} rad at "
                f"joint {j}; allowed {limits.lower[j]:.4f} to {limits.upper[j]:.4f}"
            )
        self._joints = joints
        room = ROUNDING * (limits.soft_upper - limits.soft_lower)
        self._low, self._high = limits.soft_lower + room, limits.soft_upper - room
        self._velocity = (limits.velocity * (1.0 - ROUNDING)).tolist()
        self._cruise = (limits.cruise * (1.0 - ROUNDING)).tolist()
        self._stop = (limits.acceleration * (1.0 - ROUNDING)).tolist()
        self._otg = ruckig.Ruckig(joints, dt)
        self._input = ruckig.InputParameter(joints)
        self._output = ruckig.OutputParameter(joints)
        self._input.synchronization = ruckig.Synchronization.No
        self._input.max_jerk = (limits.jerk * (1.0 - ROUNDING)).tolist()
        self._input.max_velocity = self._velocity
        self._input.max_acceleration = self._cruise
        self._input.target_velocity = [0.0] * joints
        self._input.target_acceleration = [0.0] * joints
        self._input.current_position = start.tolist()
        self._input.target_position = start.tolist()
        self._target = start.copy()
        self._stopping = False
        self._rest = True

    @override
    def tick(self, target: Float) -> tuple[Float, Float, Float]:
        wanted = _shaped("target", target, self._joints)
        found = settle(wanted, self._low, self._high, self._target)
        if found >= 0:
            raise _not_finite("target", wanted, found)
        if self._stopping:
            self._input.control_interface = ruckig.ControlInterface.Position
            self._input.max_acceleration = self._cruise
            self._stopping = False
            found = NEW
        if found == NEW:  # setting it anew would make Ruckig plan anew
            self._input.target_position = self._target.tolist()
        return self._advance()

    @override
    def stop(self) -> tuple[Float, Float, Float]:
        if not self._stopping:
            self._input.control_interface = ruckig.ControlInterface.Velocity
            self._input.max_acceleration = self._stop
            self._stopping = True
        return self._advance()

    def _advance(self) -> tuple[Float, Float, Float]:
        try:
            result = self._otg.update(self._input, self._output)
        except ruckig.RuckigError as error:
            raise RefusedTarget(f"limiter: Ruckig refuses the motion: {error}") from error
        self._output.pass_to_input(self._input)
        now = self._output
        rows = np.array((now.new_position, now.new_velocity, now.new_acceleration))
        self._rest = result == ruckig.Result.Finished
        return rows[0], rows[1], rows[2]

    @property
    @override
    def at_rest(self) -> bool:
        return self._rest


def _shaped(name: str, values: Float, joints: int) -> Float:
    # Ruckig takes a short list silently and leaves the rest at zero.
    array = np.array(values, dtype=np.float64)
    if array.shape != (joints,):
        raise RefusedTarget(f"limiter: {name}: expected {joints} joints, got shape {array.shape}")
    return array


def _not_finite(name: str, array: Float, joint: int) -> RefusedTarget:
    return RefusedTarget(
        f"limiter: {name}: expected finite angles, got {array[joint]} at joint {joint}"
    )
