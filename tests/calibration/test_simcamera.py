from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clothrf_calibration import synthetic
from clothrf_calibration.boards import parse_board
from clothrf_calibration.simcamera import check, check_poses

from clothrf_core.camera_model import scaled
from clothrf_core.errors import ClothrfError
from clothrf_core.geometry import look_at
from clothrf_core.registry import Registry
from clothrf_core.types import CameraModel

BOARD = parse_board("chessboard:9x6:25mm")


def placed(distortion: tuple[float, ...]) -> CameraModel:
    """A camera with an off-centre principal point, somewhere in the world."""
    model = synthetic.camera(distortion=distortion)
    K = np.array(model.K)
    K[:2, 2] += [12.0, -11.0]
    T = look_at(np.array([0.8, 0.1, 0.65]), np.array([0.5, 0.0, 0.2]))
    return dataclasses.replace(model, K=K, T_world_camera=T)


@pytest.mark.parametrize(
    "backend",
    ["raster", pytest.param("sapien", marks=[pytest.mark.vulkan, pytest.mark.slow])],
)
@pytest.mark.parametrize("distortion", [(), (-0.28, 0.1, 0.001, -0.0005, 0.02)])
def test_a_rendered_camera_agrees_with_opencv_and_the_analytic_plane(
    backend: str, distortion: tuple[float, ...]
) -> None:
    # Software Vulkan draws a distorted lens slowly: half the picture is enough to see a pixel.
    model = scaled(placed(distortion), 0.5 if backend == "sapien" else 1.0)
    try:
        renderer = Registry.installed().build("camera", backend)
        renderer.__enter__()
    except ClothrfError as error:
        pytest.skip(f"{backend} is not usable here: {error}")

    with renderer:
        found = check(backend, renderer, model, BOARD, check_poses(model, BOARD, 3))

    assert found.corners == 3 * 54
    assert found.rms_px <= 0.1
    assert np.abs(found.mean_px).max() < 0.03
    assert found.depth_worst_mm <= 1.0


def test_half_a_pixel_of_offset_would_be_seen() -> None:
    model = placed(())
    K = np.array(model.K)
    K[:2, 2] += 0.5
    shifted = dataclasses.replace(model, K=K)
    registry = Registry.installed()

    class Shifted:
        """A renderer that forgets the half pixel."""

        def __init__(self) -> None:
            self.inner = registry.build("camera", "raster")

        def render(self, scene: object, camera: CameraModel) -> object:
            factor = camera.width / model.width
            K = np.array(camera.K)
            K[:2, 2] += 0.5 * factor
            return self.inner.render(scene, dataclasses.replace(camera, K=K))

    wrong = Shifted()
    with wrong.inner:
        found = check("wrong", wrong, model, BOARD, check_poses(shifted, BOARD, 2))  # type: ignore[arg-type]

    assert not found.good
    assert found.mean_px == pytest.approx([0.5, 0.5], abs=0.03)
