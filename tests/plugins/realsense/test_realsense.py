from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from clothrf_realsense.config import RealSenseConfig
from clothrf_realsense.realsense import CameraNotFound, RealSense

from clothrf_core.errors import ConfigError, StaleFrame

rs = pytest.importorskip(
    "pyrealsense2",
    reason="pyrealsense2 (and the system library libusb-1.0) is not installed",
    exc_type=ImportError,
)

W, H, FRAMES = 640, 480, 12
FX, FY, CX, CY = 384.2, 384.2, 319.5, 236.4
COLOR_FX, COLOR_CX, COLOR_CY = 616.6, 316.2, 242.1


def intrinsics(fx: float, cx: float, cy: float) -> rs.intrinsics:
    k = rs.intrinsics()
    k.width, k.height, k.fx, k.fy, k.ppx, k.ppy = W, H, fx, fx, cx, cy
    k.model, k.coeffs = rs.distortion.none, [0.0] * 5
    return k


def stream(kind: rs.stream, uid: int, form: rs.format, bpp: int, k: rs.intrinsics) -> object:
    s = rs.video_stream()
    s.type, s.index, s.uid, s.width, s.height, s.fps = kind, 0, uid, W, H, 30
    s.bpp, s.fmt, s.intrinsics = bpp, form, k
    return s


def frame(data: np.ndarray, profile: object, i: int, bpp: int) -> object:
    f = rs.software_video_frame()
    f.pixels, f.stride, f.bpp = data, W * bpp, bpp
    f.timestamp, f.domain = 1000.0 + i * 33.0, rs.timestamp_domain.hardware_clock
    f.frame_number, f.profile = i + 1, profile.as_video_stream_profile()
    return f


def plane_counts() -> np.ndarray:
    """Depth of the plane z = 0.8 + 0.2 x, counts of 1 mm; and a hole."""
    u = np.arange(W)
    z = 0.8 / (1.0 - 0.2 * (u - CX) / FX)
    counts = np.repeat(np.round(z * 1000).astype(np.uint16)[None], H, axis=0)
    counts[100:140, 300:340] = 0
    return np.ascontiguousarray(counts)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that librealsense recorded from its own software device."""
    path = tmp_path_factory.mktemp("realsense") / "plane.db3"
    device = rs.software_device()
    depth_sensor, color_sensor = device.add_sensor("Depth"), device.add_sensor("Color")
    depth_sensor.add_read_only_option(rs.option.depth_units, 0.001)
    depth = depth_sensor.add_video_stream(
        stream(rs.stream.depth, 0, rs.format.z16, 2, intrinsics(FX, CX, CY))
    )
    color = color_sensor.add_video_stream(
        stream(rs.stream.color, 1, rs.format.rgb8, 3, intrinsics(COLOR_FX, COLOR_CX, COLOR_CY))
    )
    pose = rs.extrinsics()
    pose.rotation, pose.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0.0, 0.0, 0.0]
    depth.register_extrinsics_to(color, pose)
    color.register_extrinsics_to(depth, pose)
    device.create_matcher(rs.matchers.dlr_c)
    recorder = rs.recorder(str(path), device)
    syncer = rs.syncer()
    sensors = recorder.query_sensors()
    for sensor, profile in zip(sensors, (depth, color), strict=True):
        sensor.open(profile)
        sensor.start(syncer)
    counts = plane_counts()
    pictures = []
    for i in range(FRAMES):
        rgb = np.full((H, W, 3), 10 * i, np.uint8)
        pictures += [counts, rgb]
        depth_sensor.on_video_frame(frame(counts, depth, i, 2))
        color_sensor.on_video_frame(frame(rgb, color, i, 3))
        time.sleep(0.02)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del recorder
    return path


def _read_all(camera: RealSense, stamps: list[int]) -> None:
    for _ in range(3 * FRAMES):
        stamps.append(camera.read(2.0).stamp_ns)


@pytest.fixture
def camera(recording: Path) -> RealSense:
    return RealSense(RealSenseConfig(recording=recording, realtime=False))


def test_a_recording_gives_factory_intrinsics_and_depth_unit(camera: RealSense) -> None:
    with camera:
        assert camera.camera.K[0, 0] == pytest.approx(COLOR_FX, abs=1e-4)
        assert camera.camera.K[1, 2] == pytest.approx(COLOR_CY, abs=1e-4)
        assert camera.camera.distortion.size == 0
        assert camera.depth_unit == pytest.approx(0.001)


def test_depth_is_aligned_to_colour_and_true_to_a_millimetre(camera: RealSense) -> None:
    with camera:
        depth = camera.read(5.0).depth

    u = np.arange(W)
    truth = np.repeat((0.8 / (1.0 - 0.2 * (u - COLOR_CX) / COLOR_FX))[None], H, axis=0)
    error = np.abs(depth - truth)[40:-40, 40:-40]
    assert np.nanmedian(error) < 0.001
    assert np.nanmax(error) < 0.003


def test_what_was_not_measured_is_nan(camera: RealSense) -> None:
    with camera:
        depth = camera.read(5.0).depth

    v, u = round((120 - CY) / FY * COLOR_FX + COLOR_CY), round(COLOR_CX)
    assert np.isnan(depth[v, u])
    assert not (depth == 0.0).any()


def test_stamps_increase_until_the_recording_ends(camera: RealSense) -> None:
    stamps: list[int] = []

    with camera, pytest.raises(StaleFrame, match="the recording has ended"):
        _read_all(camera, stamps)

    assert FRAMES - 2 <= len(stamps) <= FRAMES

    assert np.allclose(np.diff(stamps), 33e6)


def test_frames_stay_valid_after_the_camera_is_closed(camera: RealSense) -> None:
    with camera:
        frame = camera.read(5.0)
    copy = frame.rgb.copy()

    assert (frame.rgb == copy).all()
    assert frame.rgb.base is None or not frame.rgb.flags.writeable


def test_filters_keep_the_plane(recording: Path) -> None:
    config = RealSenseConfig(recording=recording, realtime=False, spatial=True, temporal=True)

    with RealSense(config) as camera:
        depth = camera.read(5.0).depth

    assert depth[240, 316] == pytest.approx(0.8, abs=0.003)


def test_a_calibrated_file_replaces_the_factory_intrinsics(recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "my.camera.toml"
    path.write_text(
        "[camera]\nwidth = 640\nheight = 480\n"
        "K = [[600.0, 0.0, 320.0], [0.0, 601.0, 240.0], [0.0, 0.0, 1.0]]\n"
        "distortion = [0.1, -0.2, 0.0, 0.0, 0.0]\n"
        "T_world_camera = [[1.0,0.0,0.0,0.5],[0.0,1.0,0.0,0.0],"
        "[0.0,0.0,1.0,0.0],[0.0,0.0,0.0,1.0]]\n"
    )
    config = RealSenseConfig(recording=recording, realtime=False, camera_file=path)

    with RealSense(config) as camera:
        model = camera.read(5.0).camera

    assert model.K[1, 1] == 601.0
    assert model.T_world_camera[0, 3] == 0.5
    assert model.distortion.size == 5


def test_a_calibrated_file_of_another_resolution_is_refused(
    recording: Path, tmp_path: Path
) -> None:
    path = tmp_path / "my.camera.toml"
    path.write_text(
        "[camera]\nwidth = 1280\nheight = 720\n"
        "K = [[600.0, 0.0, 320.0], [0.0, 601.0, 240.0], [0.0, 0.0, 1.0]]\n"
        "T_world_camera = [[1.0,0.0,0.0,0.5],[0.0,1.0,0.0,0.0],"
        "[0.0,0.0,1.0,0.0],[0.0,0.0,0.0,1.0]]\n"
    )
    config = RealSenseConfig(recording=recording, realtime=False, camera_file=path)

    with (
        pytest.raises(ConfigError, match="expected intrinsics of 640 x 480 as the camera delivers"),
        RealSense(config),
    ):
        pass


def test_no_camera_plugged_in_is_said_in_one_line() -> None:
    if len(rs.context().query_devices()):
        pytest.skip("a RealSense is plugged in")

    with pytest.raises(CameraNotFound) as caught, RealSense(RealSenseConfig()):
        pass

    assert str(caught.value) == (
        "realsense: no camera is plugged in; check the USB 3 cable and the udev rules, or play a "
        "recording with `recording`"
    )


def test_a_file_that_is_no_recording_is_said_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    path.write_bytes(b"nothing")

    with (
        pytest.raises(CameraNotFound, match="expected a recording made by librealsense"),
        RealSense(RealSenseConfig(recording=path)),
    ):
        pass


def test_reading_a_closed_camera_is_said_in_one_line(camera: RealSense) -> None:
    with pytest.raises(StaleFrame, match="the camera is closed"):
        camera.read()
