"""Inverse kinematics of both grippers at once, as a small quadratic programme.

Each iteration minimises, over the joint step x with ``l <= x <= u``,

    |J_p x - e_p|^2 + w_o^2 |J_o x - e_o|^2 + w_q^2 |x - x_ready|^2 + damping |x|^2

subject to ``d_k + D_k x >= d_min`` for all pairs of bodies closer than 5 cm (Escande, Mansard and
Wieber 2014 for the task form; Faverjon and Tournassoud 1987 for the collision rows). The bounds
come from speed and position limits and hold exactly; x = 0 is always a solution inside the limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import daqp
import numpy as np
import pinocchio as pin

from clothrf_core.errors import RefusedTarget
from clothrf_core.types import Float
from clothrf_yumi.body import Body, Near
from clothrf_yumi.kinematics import Kinematics
from clothrf_yumi.limits import Limits

NEAR_M = 0.05  # pairs closer than this get a row
CURVATURE_M = 5e-4  # what a step may come closer than its rows say
SHARES = (0.5, 0.25, 0.1, 0.0)
SETTLED_RAD = 1e-4  # an iteration that turns no joint farther is the last
PROGRESS = 0.02  # an arm that gets nearer by a smaller share of its path is not on its way
LEVENBERG = 1e-2  # damping a square metre of error
STALE_RAD = 0.02  # turned farther than this, distances are measured again
OPTIMAL = 1  # daqp's exit flag


@dataclass(frozen=True, slots=True)
class Weights:
    """What the solver cares about besides the grasp points.

    Attributes:
        orientation: metres a radian; 0 leaves the tools free to turn.
        turn_rate: how fast tools are turned back to their orientation, rad/s; however far off
            they are, they never whip round.
        posture: metres a radian towards the ready posture; settles the elbows.
        posture_rate: how fast the arms drift there, 1/s.
        damping: (metres a radian)^2.
    """

    orientation: float = 0.3
    turn_rate: float = 1.0
    posture: float = 1e-3
    posture_rate: float = 1.0
    damping: float = 1e-6


@dataclass(frozen=True, slots=True)
class Patience:
    """When the solver is content and when it gives up.

    Attributes:
        iterations: quadratic programmes a call.
        tolerance: content when both points are this close, m.
        jump: farthest allowed target, m.
        reach: an arm that stays farther than this from its target and is not held back by its
            speed cannot reach it, m.
        clearance: least distance of any two bodies, m.
        turn: longest step of a joint in one iteration, rad.
    """

    iterations: int = 4
    tolerance: float = 1e-4
    jump: float = 0.1
    reach: float = 0.01
    clearance: float = 0.025
    turn: float = 0.4


class InverseKinematics:
    """Steps from one posture towards two grasp points.

    Args:
        kinematics: work space shared with `body`.
        body: what must not touch.
        limits: joint limits and speeds.
        ready: (14,) preferred posture.
        rotations: (2, 3, 3) preferred rotations of the tools whose tips are at (2, 3), world.
        weights: of the tasks.
        patience: bounds of the search.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        body: Body,
        *,
        limits: Limits,
        ready: Float,
        rotations: Callable[[Float], Float],
        weights: Weights,
        patience: Patience,
    ) -> None:
        self._kinematics, self._body = kinematics, body
        self._limits, self._ready, self._rotations = limits, ready, rotations
        self._weights, self._patience = weights, patience
        self._unhurried = patience.turn / limits.velocity.max()
        self._open = np.full(len(body.pairs), np.inf)
        self._no_rows = np.zeros((0, ready.size))
        self._tasks = 6 if weights.orientation == 0.0 else 12

    def solve(self, q: Float, targets: Float, dt: float) -> Float:
        """(14,) posture within `dt` seconds of `q` that brings the grippers nearest to `targets`.

        Raises:
            RefusedTarget: not finite, farther than a jump, out of reach or blocked.
        """
        q, targets = _checked("q", q, self._ready.shape), _checked("targets", targets, (2, 3))
        kinematics, patience, limits = self._kinematics, self._patience, self._limits
        kinematics.update(q)
        begin = kinematics.points.copy()
        gaps = targets - begin
        self._refuse_jumps(gaps)
        tools = self._rotations(targets) if self._tasks == 12 else self._no_rows
        room = limits.velocity * dt
        # Outside the limits the only way is back, as fast as allowed.
        low = q + np.maximum(-room, np.minimum(limits.soft_lower - q, room))
        high = q + np.minimum(room, np.maximum(limits.soft_upper - q, -room))
        x, seen, near = q, q, self._body.near(NEAR_M)
        floor = min([patience.clearance - CURVATURE_M, *near.distance.tolist()])
        for _ in range(patience.iterations):
            if x is not seen and np.abs(x - seen).max() > STALE_RAD:
                seen, near = x, self._body.near(NEAR_M)
            wanted = self._step(x, gaps, tools, low - x, high - x, dt, near, x - seen)
            moved = np.minimum(np.maximum(x + wanted, low), high)
            change, x = moved - x, moved
            kinematics.update(x)
            gaps = targets - kinematics.points
            if max(_lengths(gaps)) < patience.tolerance or np.abs(change).max() < SETTLED_RAD:
                break
        apart = self._stay_apart(q, x, floor)
        fast = bool((np.abs(apart - q) >= room * (1.0 - 1e-6)).any())
        self._refuse_unreachable(begin, targets, fast=fast, shortened=apart is not x)
        return apart

    def _stay_apart(self, q: Float, x: Float, floor: float) -> Float:
        """The part of the step from `q` to `x` after which nothing is closer than `floor`.

        The rows are straight lines through curved distances and see 5 cm far: long steps need this.
        """
        if not self._body.closer(floor):
            return x
        for share in SHARES:
            part = q + share * (x - q)
            self._kinematics.update(part)
            if not self._body.closer(floor):
                break
        return part

    def _step(
        self,
        x: Float,
        gaps: Float,
        tools: Float,
        low: Float,
        high: Float,
        dt: float,
        near: Near,
        moved: Float,
    ) -> Float:
        weights, turn = self._weights, self._patience.turn
        J = self._kinematics.grasp_jacobian()[: self._tasks]
        error = np.empty(self._tasks)
        error[:6] = gaps.ravel()
        if self._tasks == 12:
            most = weights.turn_rate * dt
            for i, now in enumerate(self._kinematics.rotations()):
                turned = pin.log3(tools[i] @ now.T)
                angle = math.sqrt(turned @ turned)
                error[6 + 3 * i : 9 + 3 * i] = turned * min(1.0, most / max(angle, 1e-12))
            error[6:] *= weights.orientation
            J[6:] *= weights.orientation
        stiffness = weights.posture**2
        pull = stiffness * min(1.0, weights.posture_rate * dt)
        # Levenberg's damping grows with the error: far targets are approached in steady steps.
        damping = weights.damping + stiffness + LEVENBERG * float(error[:6] @ error[:6])
        H = J.T @ J
        H.reshape(-1)[:: H.shape[0] + 1] += damping
        f = pull * (x - self._ready) - error @ J
        lower, upper = low, high
        if dt > self._unhurried:
            lower, upper = np.clip(low, -turn, turn), np.clip(high, -turn, turn)
        rows = self._no_rows
        if near.distance.size:
            rows = near.rows
            # Never closer; what is too close already need not part, so x = 0 stays a solution.
            distance = near.distance + rows @ moved
            floor = np.minimum(self._patience.clearance - distance, 0.0)
            upper = np.concatenate([upper, self._open[: floor.size]])
            lower = np.concatenate([lower, floor])
        step, _, flag, _ = daqp.solve(H, f, rows, upper, lower)
        if flag != OPTIMAL:
            raise RefusedTarget(
                "targets: joint limits and distances leave no motion (the solver answers "
                f"{flag}); move the arms apart or back into their limits"
            )
        result: Float = step
        return result

    def _refuse_jumps(self, gaps: Float) -> None:
        jumps = _lengths(gaps)
        i = jumps.index(max(jumps))
        if jumps[i] > self._patience.jump:
            raise RefusedTarget(
                f"targets[{i}]: expected at most {self._patience.jump} m from the gripper, got "
                f"{jumps[i]:.3f} m; approach it in smaller steps"
            )

    def _refuse_unreachable(
        self, begin: Float, targets: Float, *, fast: bool, shortened: bool
    ) -> None:
        points = self._kinematics.points
        distances = _lengths(targets - points)
        i = distances.index(max(distances))
        if distances[i] <= self._patience.reach:
            return
        progress = _lengths(targets - begin)[i] - distances[i]
        if fast and progress > PROGRESS * _lengths(points - begin)[i]:
            return
        clearance, pair = self._body.clearance()
        reason = (
            f"blocked by {pair}"
            if shortened or clearance < self._patience.clearance + 0.002
            else "the joint limits end there"
        )
        raise RefusedTarget(
            f"targets[{i}]: expected a point within reach, got {np.round(targets[i], 3).tolist()}; "
            f"the gripper stays {distances[i]:.3f} m away ({reason})"
        )


def _lengths(vectors: Float) -> list[float]:
    # Two short vectors: the standard library is faster than numpy here.
    return [math.hypot(*vector) for vector in vectors.tolist()]


def _checked(name: str, values: Float, shape: tuple[int, ...]) -> Float:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise RefusedTarget(f"{name}: expected shape {shape}, got {array.shape}")
    flat = array.ravel()
    if not math.isfinite(flat @ flat):
        raise RefusedTarget(f"{name}: expected finite numbers, got {array.tolist()}")
    return array
