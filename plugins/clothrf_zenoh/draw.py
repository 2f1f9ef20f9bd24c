"""A recording as a film, drawn by whichever camera that draws is asked for.

It shows what the recording knows: arms as measured, the robot's body, and where the policy wanted
the grippers. Cloth and hands are on no wire.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from clothrf_core.errors import ConfigError, DataError
from clothrf_core.geometry import look_at
from clothrf_core.interfaces import ArmModel, RenderedCamera
from clothrf_core.plots import animation_gif
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.scene import Label, Scene, SceneMesh, box, capsule, sphere
from clothrf_core.types import CameraModel, Float
from clothrf_zenoh.faults import MalformedMessage
from clothrf_zenoh.keys import JOINT_STATE, POSE_ARRAY
from clothrf_zenoh.messages import decode_joint_state, decode_pose_array

ARM, BODY, TABLE = (0.62, 0.62, 0.60), (0.50, 0.50, 0.50), (0.45, 0.44, 0.42)
TARGET = (0.8, 0.1, 0.0)
TARGET_RADIUS = 0.025  # m, wider than a finger, which is mostly where its target is
FORGOTTEN_S = 0.5  # a target without a successor for so long is not drawn any more


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """What a recording says about where things were.

    Attributes:
        times: (N,) seconds from the first posture.
        postures: (N, J) measured joint positions.
        target_times: (M,) seconds, on the same clock.
        targets: (M, 2, 3) where the policy wanted the grippers, world, metres.
    """

    times: Float
    postures: Float
    target_times: Float
    targets: Float

    def at(self, t: float) -> tuple[Float, Float]:
        """(J,) posture and (2, 3) targets at `t` seconds; (0, 3) where none is of that time."""
        posture = self.postures[min(int(np.searchsorted(self.times, t)), len(self.times) - 1)]
        last = int(np.searchsorted(self.target_times, t, side="right")) - 1
        if last < 0 or t - self.target_times[last] > FORGOTTEN_S:
            return posture, np.zeros((0, 3))
        return posture, self.targets[last]


def read_footage(path: Path, names: tuple[str, ...]) -> Footage:
    """Measured joints and the targets of a recording, which need not hold any targets.

    Raises:
        DataError: not an intact recording, no joint states, or states of other arms.
    """
    times, postures, target_times, targets = [], [], [], []
    try:
        with path.open("rb") as file:
            for schema, _, message in make_reader(file).iter_messages():
                kind = "" if schema is None else schema.name
                if kind == JOINT_STATE.name:
                    state = decode_joint_state(message.data)
                    if state.names != names:
                        raise DataError(f"{path}: expected the joints {names[0]}..., found others")
                    times.append(state.stamp_ns)
                    postures.append(state.positions)
                elif kind == POSE_ARRAY.name:
                    wanted = decode_pose_array(message.data)
                    if wanted.positions.shape == (2, 3):
                        target_times.append(wanted.stamp_ns)
                        targets.append(wanted.positions)
    except FileNotFoundError as error:
        raise DataError(f"{path}: expected a recording, found no file") from error
    except (McapError, MalformedMessage, OSError, ValueError) as error:
        raise DataError(f"{path}: expected an intact recording, found {error}") from error
    if not times:
        raise DataError(f"{path}: expected joint states ({JOINT_STATE.name}), found none")
    # Differences first: nanoseconds since 1970 are too long for a float.
    when, told = (np.array(stamps, np.int64) - times[0] for stamps in (times, target_times))
    return Footage(
        times=when.astype(np.float64) * 1e-9,
        postures=np.array(postures),
        target_times=told.astype(np.float64) * 1e-9,
        targets=np.array(targets).reshape(-1, 2, 3),
    )


def arm_scene(arm: ArmModel, q: Float, targets: Float, table: SceneMesh) -> Scene:
    """`arm` at (J,) `q` with its body, over a table, and (K, 3) `targets` as small balls."""
    return Scene(
        meshes=(
            table,
            *(box(low, high, Label.TABLE, BODY) for low, high in arm.fixtures()),
            *(capsule(a, b, radius, Label.GRIPPER, ARM) for a, b, radius in arm.capsules(q)),
            *(sphere(t, TARGET_RADIUS, Label.OCCLUDER, TARGET) for t in targets),
        )
    )


def spectator() -> CameraModel:
    """A camera in front of the robot and to its left that sees both arms; for people."""
    K = np.array([[520.0, 0.0, 319.5], [0.0, 520.0, 239.5], [0.0, 0.0, 1.0]])
    pose = look_at(np.array([1.35, -0.95, 0.85]), np.array([0.20, 0.0, 0.30]))
    return CameraModel(640, 480, K, pose, near=0.1, far=4.0)


def film(
    recording: Path,
    arm: ArmModel,
    registry: Registry,
    *,
    camera: str = "raster",
    rate_hz: float = 10.0,
    on_frame: Callable[[int], None] = lambda _: None,
) -> bytes:
    """A GIF of robot and targets at `rate_hz` frames a second.

    Args:
        recording: an MCAP file of `clothrf record`.
        arm: the model of the recorded arms.
        registry: where the camera comes from.
        camera: name of a camera that draws, as ``raster`` or ``sapien``.
        rate_hz: frames a second.
        on_frame: told how many frames there will be, for each one drawn.

    Raises:
        DataError: the recording is damaged or of other arms.
        ConfigError: that camera does not draw.
    """
    footage = read_footage(recording, arm.joint_names)
    instants = np.arange(0.0, footage.times[-1] + 1e-9, 1.0 / rate_hz).tolist()
    renderer = registry.build("camera", camera, None, BuildContext(registry=registry))
    if not isinstance(renderer, RenderedCamera):
        raise ConfigError(f"camera '{camera}' reads pictures; expected one that draws: raster")
    ground = box(np.array([0.0, -0.6, -0.04]), np.array([1.1, 0.6, -0.02]), Label.TABLE, TABLE)
    view, frames = spectator(), []
    with renderer:
        for i, t in enumerate(instants):
            scene = dataclasses.replace(arm_scene(arm, *footage.at(t), ground), stamp_ns=i)
            frames.append(np.array(renderer.render(scene, view).frame.rgb))
            on_frame(len(instants))
    return animation_gif(frames, frame_s=1.0 / rate_hz)
