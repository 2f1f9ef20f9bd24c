"""The arms of a recording as a film, drawn by whichever camera that draws is asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
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
from clothrf_core.scene import Label, Scene, SceneMesh, box, capsule
from clothrf_core.types import CameraModel, Float
from clothrf_zenoh.faults import MalformedMessage
from clothrf_zenoh.keys import JOINT_STATE
from clothrf_zenoh.messages import decode_joint_state

ARM, TABLE = (0.62, 0.62, 0.60), (0.45, 0.44, 0.42)


def read_postures(path: Path, names: tuple[str, ...]) -> tuple[Float, Float]:
    """(N,) seconds from 0 and (N, J) measured joint positions of a recording.

    Raises:
        DataError: not an intact recording, no joint states, or states of other arms.
    """
    times, postures = [], []
    try:
        with path.open("rb") as file:
            for schema, _, message in make_reader(file).iter_messages():
                if schema is not None and schema.name == JOINT_STATE.name:
                    state = decode_joint_state(message.data)
                    if state.names != names:
                        raise DataError(f"{path}: expected the joints {names[0]}..., found others")
                    times.append(state.stamp_ns)
                    postures.append(state.positions)
    except FileNotFoundError as error:
        raise DataError(f"{path}: expected a recording, found no file") from error
    except (McapError, MalformedMessage, OSError, ValueError) as error:
        raise DataError(f"{path}: expected an intact recording, found {error}") from error
    if not times:
        raise DataError(f"{path}: expected joint states ({JOINT_STATE.name}), found none")
    stamps = np.array(times, float)
    return (stamps - stamps[0]) * 1e-9, np.array(postures)


def arm_scene(arm: ArmModel, q: Float, table: SceneMesh) -> Scene:
    """The bodies of `arm` at (J,) `q` over a table."""
    bodies = [
        capsule(start, end, radius, Label.GRIPPER, ARM) for start, end, radius in arm.capsules(q)
    ]
    return Scene(meshes=(table, *bodies))


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
    """A GIF of the measured arms at `rate_hz` frames a second.

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
    times, postures = read_postures(recording, arm.joint_names)
    wanted = np.arange(0.0, times[-1] + 1e-9, 1.0 / rate_hz)
    chosen = np.searchsorted(times, wanted).clip(0, len(times) - 1)
    renderer = registry.build("camera", camera, None, BuildContext(registry=registry))
    if not isinstance(renderer, RenderedCamera):
        raise ConfigError(f"camera '{camera}' reads pictures; expected one that draws: raster")
    ground = box(np.array([0.0, -0.6, -0.04]), np.array([1.1, 0.6, -0.02]), Label.TABLE, TABLE)
    view, frames = spectator(), []
    with renderer:
        for i, row in enumerate(chosen):
            scene = dataclasses.replace(arm_scene(arm, postures[row], ground), stamp_ns=i)
            frames.append(np.array(renderer.render(scene, view).frame.rgb))
            on_frame(len(chosen))
    return animation_gif(frames, frame_s=1.0 / rate_hz)
