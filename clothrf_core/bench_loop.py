"""Frame to command: pictures played from a folder at the pace of a camera, through the whole loop.

The latency of a turn runs from the moment a picture appears (its stamp) to the moment the command
made from it was handed to the robot. The loop is the one of `clothrf run`, with its scheduling; the
picture is decoded before it appears, as a camera's is; the robot takes commands and does nothing.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from clothrf_core import compose, config, imitation
from clothrf_core.bench import Quiet
from clothrf_core.collection import ONE_THREAD
from clothrf_core.gallery import in_colour
from clothrf_core.interfaces import Policy
from clothrf_core.limits import Limits
from clothrf_core.live import LOOP_PRIORITY, Session
from clothrf_core.locations import shipped
from clothrf_core.loop import Controller, Step
from clothrf_core.opening import NothingToOpen
from clothrf_core.provider import BuildContext, Figure
from clothrf_core.punctual import punctual
from clothrf_core.registry import Registry
from clothrf_core.rollout import stream
from clothrf_core.run_folder import RunFolder
from clothrf_core.types import Float, GraspState, RobotCommand

TRAINING = {"training.iterations": 2, "evaluation.rollouts": 2, "evaluation.steps": 10}
# Turns that are not counted: memory is found, caches fill.
WARM_UP = 30
LOAD = """
from pathlib import Path
from clothrf_core.rollout import RolloutJob
i = 0
while True:
    out = Path({folder!r}) / f"load{{i}}.npz"
    RolloutJob({config!r}, str(out), 0, "iteration", 1, i, "straight", 100).run()
    i += 1
"""


@dataclass
class Sink(NothingToOpen):
    """A robot that takes commands and stays."""

    positions: Float

    def state(self) -> GraspState:
        """Where it stays."""
        return GraspState(self.positions, time.monotonic_ns())

    def send(self, command: RobotCommand) -> RobotCommand:
        """Taken."""
        return command


@dataclass
class Latencies:
    """Nanoseconds from the stamp of a frame to the end of its turn."""

    values: list[int] = field(default_factory=list)

    def on_step(self, step: Step) -> None:
        """Take the time of one turn."""
        self.values.append(time.monotonic_ns() - step.observation.frame.stamp_ns)


def frame_to_command(quick: bool) -> list[Figure]:  # noqa: FBT001
    """Median on a quiet machine at 30, 60 and 90 fps; p99 with a simulator running beside it."""
    registry = Registry.installed()
    frames = 150 if quick else 900
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        resolved = config.load(shipped("straight.toml"), registry, dict(TRAINING))
        run = RunFolder.start(folder / "run", resolved, resume=False)
        imitation.dagger(run, registry, Quiet())
        policy, resolved = compose.open_policy(run.best, registry)
        write_pictures(resolved, registry, folder / "pictures", count=60)
        alone = {
            fps: _play(resolved, registry, policy, folder / "pictures", fps, frames)
            for fps in (30.0, 60.0, 90.0)
        }
        code = LOAD.format(folder=name, config=str(run.experiment))
        load = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, **ONE_THREAD})
        try:
            time.sleep(8.0 if quick else 12.0)  # imports and compiled kernels
            busy, plain = (
                _play(resolved, registry, policy, folder / "pictures", 30.0, frames, priority)
                for priority in (LOOP_PRIORITY, 0)
            )
        finally:
            load.kill()
            load.wait()
    with punctual(LOOP_PRIORITY) as granted:
        pass
    detail = {f"median_{fps:.0f}fps_ms": _ms(v, 50) for fps, v in alone.items()}
    detail |= {f"p99_{fps:.0f}fps_ms": _ms(v, 99) for fps, v in alone.items()}
    return [
        Figure("frame_to_command_ms", _ms(alone[30.0], 50), "ms", detail),
        Figure(
            "frame_to_command_ms_p99",
            _ms(busy, 99),
            "ms",
            {
                "beside": "one simulator process of one thread",
                "scheduling": granted,
                "median_ms": _ms(busy, 50),
                "p99_without_priority_ms": _ms(plain, 99),
            },
        ),
    ]


def write_pictures(
    resolved: config.Resolved, registry: Registry, folder: Path, *, count: int
) -> None:
    """Frames of a simulated roll-out as a folder of pictures with their camera file."""
    import cv2

    folder.mkdir(parents=True)
    shop = compose.workshop(in_colour(resolved), registry)
    expert = next(iter(shop.experts.values()))
    shop.world.reset(stream(0, "episode", 0, 0), expert)
    unit = resolved.rig.camera.depth_unit
    with shop.camera:
        for i in range(count):
            frame = shop.camera.read()
            counts = np.nan_to_num(np.rint(frame.depth / unit), nan=0.0).astype(np.uint16)
            cv2.imwrite(filename=str(folder / f"{i:04d}_depth.png"), img=counts)
            bgr = np.ascontiguousarray(frame.rgb[:, :, ::-1])
            cv2.imwrite(filename=str(folder / f"{i:04d}_color.png"), img=bgr)
            targets = np.array(expert.label(shop.world.state).targets)
            shop.world.advance(RobotCommand(i, 0, 1.0, targets))
    camera = resolved.rig.camera.model_dump(mode="json")
    text = tomli_w.dumps({"kind": "camera", "version": 1, "camera": camera})
    (folder / "camera.toml").write_text(text)


def _play(
    resolved: config.Resolved,
    registry: Registry,
    policy: Policy,
    pictures: Path,
    fps: float,
    frames: int,
    priority: int = LOOP_PRIORITY,
) -> Float:
    provider = registry.find("camera", "folder")
    options = provider.config.model_validate(
        {"path": pictures, "playback": "realtime", "fps": fps, "loop": True}
    )
    context = BuildContext(rig=resolved.rig, registry=registry)
    camera: Any = registry.build("camera", "folder", options, context)
    limits = Limits(resolved.experiment.limits, 1.0 / fps)
    controller = Controller(
        camera,
        compose.extractor(resolved, registry),
        policy,
        limits,
        Sink(resolved.rig.rest_grasp),
        policy.tasks[0],
    )
    latencies = Latencies()
    gc.collect()
    Session(controller, fps, paced_by_camera=True, priority=priority).run(
        seconds=None,
        observers=(latencies,),
        stopped=lambda: len(latencies.values) >= WARM_UP + frames,
    )
    return np.array(latencies.values[WARM_UP:], float)


def _ms(values: Float, percentile: float) -> float:
    return 1e-6 * float(np.percentile(values, percentile))
