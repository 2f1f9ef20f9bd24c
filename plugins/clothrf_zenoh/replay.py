"""Plays the joint commands of a recording into a bridge, at the speed at which they were sent.

The bridge checks them like anybody's: they get a new publisher id, new sequence numbers and stamps,
the grant must be asked for, and the first command must begin where the arms are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from clothrf_core.clock import Clock
from clothrf_core.errors import DataError
from clothrf_core.types import Float
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.faults import MalformedMessage
from clothrf_zenoh.keys import JOINT_TRAJECTORY
from clothrf_zenoh.messages import JointTrajectory, JointTrajectoryCodec


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """The joint commands of a recording.

    Attributes:
        times_ns: (N,) int64 stamps, from 0.
        positions: (N, J) float64, rad.
        velocities: (N, J) float64, rad/s.
    """

    times_ns: np.ndarray[tuple[int], np.dtype[np.int64]]
    positions: Float
    velocities: Float


def read_commands(path: Path, names: tuple[str, ...]) -> Recorded:
    """The joint commands in `path`, in the order in which they were sent.

    Raises:
        DataError: no such file, not an intact MCAP file, no commands, or commands for other arms.
    """
    codec = JointTrajectoryCodec(names)
    commands: list[JointTrajectory] = []
    try:
        with path.open("rb") as file:
            for schema, _, message in make_reader(file).iter_messages():
                if schema is not None and schema.name == JOINT_TRAJECTORY.name:
                    commands.append(codec.decode(message.data))
    except FileNotFoundError as error:
        raise DataError(f"{path}: expected a recording, found no file") from error
    except MalformedMessage as error:
        raise DataError(f"{path}: expected commands for these arms; {error}") from error
    except (McapError, OSError, ValueError) as error:
        raise DataError(f"{path}: expected an intact MCAP file, found {error}") from error
    if not commands:
        raise DataError(f"{path}: expected joint commands ({JOINT_TRAJECTORY.name}), found none")
    commands.sort(key=lambda c: c.stamp_ns)
    times = np.array([c.stamp_ns for c in commands], np.int64)
    return Recorded(
        times - times[0],
        np.array([c.positions for c in commands]),
        np.array([c.velocities for c in commands]),
    )


def replay(
    recorded: Recorded,
    client: BridgeClient,
    clock: Clock,
    *,
    lease_s: float = 0.3,
    stop: Callable[[], bool] = lambda: False,
) -> int:
    """Arm and play; returns how many commands were sent before the end or the bridge's stop.

    Raises:
        BridgeRefused: the bridge does not give the arms.
        BridgeUnreachable: no bridge.
    """
    posture = client.arm(lease_s)
    far = float(np.abs(recorded.positions[0] - posture).max())
    if far > 0.05:
        client.release()
        raise DataError(
            f"recording: expected to begin within 0.05 rad of the arms' posture, found {far:.3f} "
            "rad; move the arms to its start first"
        )
    start = clock.now_ns()
    renewed = start
    sent = 0
    for at, q, qd in zip(
        recorded.times_ns.tolist(), recorded.positions, recorded.velocities, strict=True
    ):
        clock.sleep_until_ns(start + at)
        client.poll()
        if stop() or not client.held:
            break
        client.send(q, qd)
        sent += 1
        if clock.now_ns() - renewed > 1e9 * lease_s / 3:
            renewed = clock.now_ns()
            client.renew()
    client.release()
    return sent
