"""30 Hz grasp targets to a 250 Hz joint motion: set-point, inverse kinematics, limiter.

The set-point walks towards the targets at a limited speed, both grippers by the same fraction of
their way, so that the cloth between them is not pulled askew, and more slowly the nearer they are,
so that targets that tremble do not make it run; the arm model turns it into a posture; the limiter
makes that a motion within speed, acceleration and jerk. Pure logic: no time, no network.
"""

from __future__ import annotations

import numpy as np

from clothrf_core.errors import RefusedTarget
from clothrf_core.interfaces import ArmModel
from clothrf_core.types import Float

# Closing a gap takes at least so long. Costs half a millimetre of lag, saves a fifth of the speed.
EASE_S = 0.06


class Follower:
    """One motion, from a posture at rest.

    Args:
        arm: kinematics.
        dt: seconds a tick.
        q: (J,) posture to begin at.
        tcp_speed: of the set-point, m/s.
        max_step: targets farther than this from the set-point are refused, m.
    """

    def __init__(
        self, arm: ArmModel, *, dt: float, q: Float, tcp_speed: float, max_step: float
    ) -> None:
        self._arm = arm
        self._dt = dt
        self._step = tcp_speed * dt
        self._share = min(1.0, dt / EASE_S)
        self._max_step = max_step
        self._limiter = arm.limiter(dt, q=q)
        self._q = np.array(q, float)
        self._restart()

    def _restart(self) -> None:
        """The set-point and the inverse kinematics begin anew where the limiter is."""
        self._posture = np.array(self._q)
        self._point = np.array(self._arm.grasp_points(self._q))
        self._goal: Float | None = None

    @property
    def at_rest(self) -> bool:
        """Nothing moves."""
        return self._limiter.at_rest

    @property
    def q(self) -> Float:
        """(J,) posture of the last tick."""
        return self._q

    def aim(self, targets: Float) -> None:
        """Head for (2, 3) `targets`, world.

        Raises:
            RefusedTarget: not finite or too far; the old goal is given up and the arms stop.
        """
        far = float(np.linalg.norm(targets - self._point, axis=1).max())
        if not far <= self._max_step:
            self.halt()
            raise RefusedTarget(
                f"targets: expected within {self._max_step:g} m of the set-point, found {far:.3f} m"
            )
        self._goal = targets

    def halt(self) -> None:
        """Stop, and stay until the next `aim`."""
        self._goal = None

    def tick(self) -> tuple[Float, Float]:
        """(q, qd) of the next tick.

        Raises:
            RefusedTarget: the arm model cannot go on; halted, call again for the stop.
        """
        goal = self._goal
        if goal is None:
            if not self._limiter.at_rest:
                self._q, qd, _ = self._limiter.stop()
                if self._limiter.at_rest:
                    self._restart()
                return self._q, qd
            return self._q, np.zeros(len(self._q))
        way = goal - self._point
        longest = float(np.linalg.norm(way, axis=1).max())
        point = self._point + way * min(self._share, self._step / max(longest, 1e-12))
        try:
            posture = self._arm.solve(self._posture, point, self._dt)
            self._q, qd, _ = self._limiter.tick(posture)
        except RefusedTarget:
            self._restart()
            raise
        # The set-point goes on from where the joints could follow it, so it never runs away.
        self._posture, self._point = posture, self._arm.grasp_points(posture)
        return self._q, qd
