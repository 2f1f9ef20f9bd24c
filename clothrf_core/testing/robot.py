"""What every `Robot` promises: it goes where it is told, and says what was really sent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothrf_core.interfaces import Robot
from clothrf_core.types import RobotCommand


def check_robot(make: Callable[[], Robot], *, reach: float = 0.02, steps: int = 60) -> None:
    """Move both grippers a little and back.

    Args:
        make: builds a fresh robot that is safe to move by `reach`.
        reach: metres to move.
        steps: commands to send.

    Raises:
        AssertionError: saying which promise is broken.
    """
    with make() as robot:
        start = robot.state()
        assert start.positions.shape == (2, 3), f"grasp has shape {start.positions.shape}"
        assert np.isfinite(start.positions).all(), "grasp is not finite"
        goal = np.array(start.positions) + [0.0, 0.0, reach]
        last = start.stamp_ns
        for sequence in range(steps):
            here = robot.state()
            assert here.stamp_ns >= last, "stamps of the state go back"
            last = here.stamp_ns
            command = RobotCommand(sequence, here.stamp_ns, 0.1, goal)
            sent = robot.send(command)
            assert sent.sequence == sequence, f"sent {sent.sequence} instead of {sequence}"
            assert np.isfinite(sent.targets).all(), "something not finite was sent"
        end = np.array(robot.state().positions)
    before = np.linalg.norm(goal - start.positions)
    after = np.linalg.norm(goal - end)
    assert after < 0.5 * before, f"still {after:.4f} m from a target {before:.4f} m away"
