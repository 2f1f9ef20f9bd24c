"""Pictures of the simulated world drawn on the CPU, without any graphics driver."""

from __future__ import annotations

from collections.abc import Sequence

from clothrf_core.hookspecs import hookimpl
from clothrf_core.interfaces import Camera
from clothrf_core.provider import Benchmark, BuildContext, Figure, Provider
from clothrf_raster.config import RasterConfig


def _camera(config: RasterConfig, context: BuildContext) -> Camera:
    from clothrf_raster.camera import RasterCamera

    return RasterCamera(config, context)


def _frame(quick: bool) -> list[Figure]:  # noqa: FBT001  the hook's signature
    from clothrf_raster.bench import frame

    return frame(quick=quick)


@hookimpl
def clothrf_cameras() -> Sequence[Provider[Camera]]:
    """The CPU renderer."""
    return [
        Provider(
            name="raster",
            summary="depth, labels and shaded colour drawn on the CPU, no graphics driver",
            build=_camera,
            config=RasterConfig,
            extra="fast",
        )
    ]


@hookimpl
def clothrf_benchmarks() -> Sequence[Benchmark]:
    """Time of a frame, beside other painters."""
    return [Benchmark(group="core", name="raster frame", run=_frame, needs="fast")]
