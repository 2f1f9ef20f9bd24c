"""Times of the arithmetic that runs at 250 Hz: inverse kinematics, motion limiter, clearance."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from clothrf_core.provider import Figure
from clothrf_core.types import Float
from clothrf_yumi.arm import TABLE_HEIGHT_M, Yumi
from clothrf_yumi.body import Body
from clothrf_yumi.config import YumiConfig
from clothrf_yumi.ik import NEAR_M
from clothrf_yumi.kinematics import Kinematics
from clothrf_yumi.limiter import RuckigLimiter
from clothrf_yumi.limits import Limits
from clothrf_yumi.posture import REST_GRASP

DT = 0.004
AMPLITUDE_M, RATE_HZ = 0.04, 0.45


def inverse_kinematics(*, quick: bool) -> list[Figure]:
    """`ik_us`: median CPU time of one solution for both arms, 250 Hz, collision rows active.

    The grippers stand 8 cm from each other's fingers and circle; beside it the same with the
    grippers 30 cm apart, as the task holds them, where few bodies are near.
    """
    rounds = 500 if quick else 4000
    close = np.array(REST_GRASP)
    close[:, 1] = [-0.07, 0.07]
    near, wide = _circle(close, rounds), _circle(np.array(REST_GRASP), rounds)
    detail: dict[str, Any] = {
        **near,
        **{f"wide_{key}": value for key, value in wide.items()},
        "clock": "thread CPU time; wall_* by the wall clock",
        "pairs": len(_body()[1].pairs),
    }
    return [Figure("ik_us", detail.pop("median"), "us", detail)]


def limiter(*, quick: bool) -> list[Figure]:
    """`ruckig_us`: median CPU time of a tick with a new calculation, 14 joints.

    Beside it how many of 100,000 ticks (quick: 2,000) under random targets left a limit of
    position, speed, acceleration or jerk, by however little.
    """
    limits = _yumi().limits
    rng = np.random.default_rng(0)
    middle = (limits.soft_lower + limits.soft_upper) / 2.0
    motion = RuckigLimiter(limits, DT, q=middle)
    targets = iter(middle + rng.uniform(-0.5, 0.5, (4000, 14)))
    new = _times(lambda: motion.tick(next(targets)), 400 if quick else 3900)
    held = middle + 0.3
    motion.tick(held)
    same = _times(lambda: motion.tick(held), 400)
    kept = _limits_kept(2_000 if quick else 100_000)
    detail = {**new, "step_only": same["median"], **kept}
    return [Figure("ruckig_us", detail.pop("median"), "us", detail)]


def _limits_kept(ticks: int) -> dict[str, float]:
    """`ticks`, those that left a limit, and the greatest share of each limit that was used."""
    limits, rng = Limits.of("normal"), np.random.default_rng(1)
    q = (limits.soft_lower + limits.soft_upper) / 2.0
    motion, span = RuckigLimiter(limits, DT, q=q), limits.upper - limits.lower
    outside, most, target = 0, np.zeros(3), q
    before, left = (q, np.zeros(q.size), np.zeros(q.size)), 0
    for _ in range(ticks):
        if left == 0:
            target = before[0] + rng.choice([0.02, 0.3, 1.5]) * span * rng.uniform(-1, 1, q.size)
            left = int(rng.integers(1, 60))
        left -= 1
        q, qd, qdd = motion.tick(target)
        used = [qd / limits.velocity, qdd / limits.cruise]
        used.append((qdd - before[2]) / DT / limits.jerk)
        shares = np.abs(used).max(axis=1)
        inside = (q >= limits.soft_lower).all() and (q <= limits.soft_upper).all()
        outside += not (inside and (shares <= 1.0).all())
        most, before = np.maximum(most, shares), (q, qd, qdd)
    names = ("speed_share", "acceleration_share", "jerk_share")
    return {
        "random_ticks": float(ticks),
        "ticks_outside_limits": float(outside),
        **dict(zip(names, most.tolist(), strict=True)),
    }


def checks(*, quick: bool) -> list[Figure]:
    """`clearance_us`: median CPU time of the least distance of all pairs on a moving arm."""
    arm = _yumi()
    begin, rng = arm.ready, np.random.default_rng(0)
    way = begin + np.cumsum(rng.normal(0.0, 1e-3, (3000, 14)), axis=0)
    postures = iter(way)
    rounds = 300 if quick else 2900
    tick = _times(lambda: arm.clearance(next(postures)), rounds)
    speeds = _times(lambda: arm.grasp_speeds(begin, arm.limits.velocity), 300)
    detail = {**tick, "grasp_speeds": speeds["median"]}
    return [Figure("clearance_us", detail.pop("median"), "us", detail)]


def _circle(centres: Float, rounds: int) -> dict[str, float]:
    arm = Yumi(YumiConfig(profile="normal"), corners=centres, table_height=TABLE_HEIGHT_M)
    kinematics, body = _body()
    posture = [arm.ready]
    errors, rows = [], []
    angles = 2.0 * np.pi * RATE_HZ * DT * np.arange(rounds + 10)
    offsets = AMPLITUDE_M * np.stack(
        [np.cos(angles) - 1.0, np.zeros(angles.size), np.sin(angles)], axis=1
    )
    step = iter(centres + offsets[:, None, :])

    def tick() -> None:
        target = next(step)
        posture[0] = arm.solve(posture[0], target, DT)
        posture.append(target)

    times = _times(tick, rounds)
    q = arm.ready
    for target in posture[1 : 1 + min(rounds, 500)]:
        q = arm.solve(q, target, DT)
        errors.append(np.linalg.norm(arm.grasp_points(q) - target, axis=1).max())
        kinematics.update(q)
        rows.append(body.near(NEAR_M).distance.size)
    return {
        **times,
        "rows_mean": float(np.mean(rows)),
        "error_max_mm": float(np.max(errors)) * 1e3,
    }


def _yumi() -> Yumi:
    corners = np.array(REST_GRASP)
    return Yumi(YumiConfig(profile="normal"), corners=corners, table_height=TABLE_HEIGHT_M)


def _body() -> tuple[Kinematics, Body]:
    config = YumiConfig()
    kinematics = Kinematics(config.tool)
    return kinematics, Body(kinematics, table_height=TABLE_HEIGHT_M, padding=config.padding)


def _times(call: Callable[[], Any], rounds: int) -> dict[str, float]:
    """Median, p99 and max microseconds of `call` by the thread's CPU clock; also by the wall's."""
    for _ in range(5):
        call()
    cpu, wall = np.empty(rounds), np.empty(rounds)
    for i in range(rounds):
        start, begun = time.thread_time_ns(), time.perf_counter_ns()
        call()
        wall[i] = time.perf_counter_ns() - begun
        cpu[i] = time.thread_time_ns() - start
    return {
        "median": float(np.median(cpu)) / 1e3,
        "p99": float(np.percentile(cpu, 99)) / 1e3,
        "max": float(cpu.max()) / 1e3,
        "wall_median": float(np.median(wall)) / 1e3,
        "wall_p99": float(np.percentile(wall, 99)) / 1e3,
    }
