"""The SAPIEN backend: cloth held by four corners, and pictures of it."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Camera, Simulator
from clothrf_core.provider import Benchmark, BuildContext, Figure, Provider
from clothrf_sapien.camera_config import SapienCameraConfig
from clothrf_sapien.config import ClothOptions


def _simulator(config: ClothOptions, context: BuildContext) -> Simulator:
    from clothrf_sapien.simulator import ClothSimulator

    return ClothSimulator(config)


def _camera(config: SapienCameraConfig, context: BuildContext) -> Camera:
    from clothrf_sapien.camera import SapienCamera

    return SapienCamera(config, context)


def _cloth_step(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_sapien.bench_physics import step

    return step(quick=quick)


def _cloth_strain(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_sapien.bench_physics import strain

    return strain(quick=quick)


def _cloth_truth(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_sapien.bench_physics import truth

    return truth(quick=quick)


def _cloth_peer(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_sapien.bench_mujoco import against_mujoco

    return against_mujoco(quick=quick)


def _cloth_newton(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_sapien.bench_newton import against_newton

    return against_newton(quick=quick)


def _picture(quick: bool) -> list[Figure]:  # noqa: FBT001
    from clothrf_sapien.camera_bench import frames

    return frames(quick=quick)


@hookimpl
def clothrf_simulators() -> Sequence[Provider[Simulator]]:
    """The implicit cloth; needs neither a GPU nor a graphics driver."""
    return [
        Provider(
            name="sapien",
            summary="implicit cloth held by four corners (Newton, banded Cholesky)",
            build=_simulator,
            config=ClothOptions,
            extra="fast",
        )
    ]


@hookimpl
def clothrf_cameras() -> Sequence[Provider[Camera]]:
    """Pictures by SAPIEN's renderer; needs a Vulkan driver."""
    return [
        Provider(
            name="sapien",
            summary="depth, labels and shaded colour by SAPIEN; needs a Vulkan driver",
            build=_camera,
            config=SapienCameraConfig,
            extra="sapien",
        )
    ]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Time, strain and truth of the cloth; time of a picture."""
    return [
        Benchmark(group="core", name="cloth step", run=_cloth_step, needs="fast"),
        Benchmark(group="core", name="cloth strain", run=_cloth_strain, needs="fast"),
        Benchmark(group="core", name="cloth truth", run=_cloth_truth, needs="fast"),
        Benchmark(group="core", name="SAPIEN frame", run=_picture, needs="vulkan"),
        Benchmark(group="scale", name="cloth against MuJoCo", run=_cloth_peer, needs="mujoco"),
        Benchmark(group="scale", name="cloth against Newton", run=_cloth_newton, needs="newton"),
    ]
