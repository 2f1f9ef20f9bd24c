"""Calibration of cameras: boards, intrinsics, camera pose, the simulated camera, and how good."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clothrf_core.hookspecs import hookimpl
from clothrf_core.provider import Benchmark, Command, Figure

if TYPE_CHECKING:
    import typer


@hookimpl
def clothrf_commands() -> Sequence[Command]:
    """``clothrf calibrate``."""
    return [Command("calibrate", "from a printed board to a camera file that says how good", _load)]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Accuracy and speed of the solvers."""
    return [
        Benchmark("calibration", "intrinsics", _intrinsics, needs="calibration"),
        Benchmark("calibration", "hand-eye", _hand_eye, needs="calibration"),
        Benchmark("calibration", "speed", _speed, needs="calibration"),
    ]


def _load() -> typer.Typer:
    from clothrf_calibration.cli import app

    return app


def _intrinsics(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_calibration import bench

    return bench.intrinsics(quick=quick)


def _hand_eye(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_calibration import bench

    return bench.hand_eye(quick=quick)


def _speed(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_calibration import bench

    return bench.speed(quick=quick)
