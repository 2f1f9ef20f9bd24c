from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from clothrf_realsense import folder as player
from clothrf_realsense.config import FolderConfig
from clothrf_realsense.folder import FolderCamera
from clothrf_realsense.pictures import read_depth

from clothrf_core.camera_file import read_camera_file
from clothrf_core.clock import ManualClock
from clothrf_core.errors import ConfigError, DataError, StaleFrame
from clothrf_core.registry import Registry
from clothrf_core.types import Float32

CAMERA = """
[camera]
width = 32
height = 24
K = [[30.0, 0.0, 15.5], [0.0, 30.0, 11.5], [0.0, 0.0, 1.0]]
T_world_camera = [[1.0,0.0,0.0,0.1],[0.0,1.0,0.0,0.2],[0.0,0.0,1.0,0.3],[0.0,0.0,0.0,1.0]]
depth_unit = 0.0005
"""

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    def write(names: list[str], *, camera: str = CAMERA, depth: bool = True) -> Path:
        folder = tmp_path / "pictures"
        folder.mkdir()
        if camera:
            (folder / "camera.toml").write_text(camera)
        for i, name in enumerate(names):
            rgb = np.zeros((24, 32, 3), np.uint8)
            rgb[..., 0] = 10 * i + 5
            raw = np.full((24, 32), 1000 + i, np.uint16)
            raw[0, 0] = 0
            cv2.imwrite(
                filename=str(folder / f"{name}_color.png"),
                img=cv2.cvtColor(src=rgb, code=cv2.COLOR_RGB2BGR),
            )
            if depth:
                cv2.imwrite(filename=str(folder / f"{name}_depth.png"), img=raw)
        return folder

    return write


def test_colour_depth_and_camera_come_back_as_they_were_written(make: Make) -> None:
    folder = make(["0001"])

    with FolderCamera(FolderConfig(path=folder)) as camera:
        frame = camera.read()

    assert (frame.rgb == [5, 0, 0]).all()
    assert np.isnan(frame.depth[0, 0])
    assert frame.depth[5, 5] == np.float32(1000 * 0.0005)
    assert frame.camera.T_world_camera[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert not frame.depth.flags.writeable


def test_pictures_come_in_natural_order_of_their_names(make: Make) -> None:
    folder = make(["f10", "f2", "f1"])

    with FolderCamera(FolderConfig(path=folder)) as camera:
        seen = [int(camera.read().rgb[0, 0, 0]) for _ in range(3)]

    assert seen == [25, 15, 5]


def test_the_end_of_the_folder_is_a_stale_frame(make: Make) -> None:
    folder = make(["1", "2"])

    with FolderCamera(FolderConfig(path=folder)) as camera:
        camera.read()
        camera.read()
        with pytest.raises(StaleFrame, match="all 2 pictures have been played"):
            camera.read()


def test_a_looped_folder_has_increasing_stamps(make: Make) -> None:
    folder = make(["1", "2", "3"])

    with FolderCamera(FolderConfig(path=folder, loop=True, fps=60)) as camera:
        stamps = [camera.read().stamp_ns for _ in range(8)]

    assert np.allclose(np.diff(stamps), 1e9 / 60, atol=2)


def test_stamps_come_from_nanosecond_names(make: Make) -> None:
    folder = make(["1700000000000000000", "1700000000040000000"])

    with FolderCamera(FolderConfig(path=folder)) as camera:
        stamps = [camera.read().stamp_ns for _ in range(2)]

    assert stamps == [1700000000000000000, 1700000000040000000]


def test_stamps_come_from_names_in_seconds(make: Make) -> None:
    folder = make(["12.5", "12.75"])

    with FolderCamera(FolderConfig(path=folder)) as camera:
        stamps = [camera.read().stamp_ns for _ in range(2)]

    assert stamps == [12_500_000_000, 12_750_000_000]


def test_stamps_csv_decides_over_names(make: Make) -> None:
    folder = make(["a", "b"])
    (folder / "stamps.csv").write_text("name,stamp_ns\na,2000\nb,1000\n")

    with FolderCamera(FolderConfig(path=folder)) as camera:
        frames = [camera.read() for _ in range(2)]

    assert [f.stamp_ns for f in frames] == [1000, 2000]
    assert int(frames[0].rgb[0, 0, 0]) == 15


def test_real_time_playback_waits_for_the_next_picture(make: Make) -> None:
    clock = ManualClock(5_000_000_000)
    config = FolderConfig(path=make(["1", "2", "3"]), playback="realtime", fps=90)

    with FolderCamera(config, clock=clock) as camera:
        stamps = [camera.read().stamp_ns for _ in range(3)]

    assert stamps == [5_000_000_000, 5_011_111_111, 5_022_222_222]
    assert clock.now_ns() == 5_022_222_222


def test_a_picture_is_decoded_before_its_time_comes_and_none_while_one_is_worked_on(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    log: list[str] = []

    class Watched(ManualClock):
        def sleep_until_ns(self, deadline_ns: int) -> None:
            log.append("wait")
            super().sleep_until_ns(deadline_ns)

    def decode(path: Path, *, unit: float) -> Float32:
        log.append(f"decode {path.stem}")
        return read_depth(path, unit=unit)

    monkeypatch.setattr(player, "read_depth", decode)
    config = FolderConfig(path=make(["1", "2"]), playback="realtime", fps=90, read_ahead=1)

    with FolderCamera(config, clock=Watched()) as camera:
        for _ in range(2):
            camera.read()
            log.append("work")

    assert log == ["decode 1_depth", "wait", "work", "decode 2_depth", "wait", "work"]


def test_real_time_playback_drops_what_was_not_read_in_time(make: Make) -> None:
    clock = ManualClock()
    config = FolderConfig(path=make(["1", "2", "3", "4"]), playback="realtime", fps=30)

    with FolderCamera(config, clock=clock) as camera:
        camera.read()
        clock.sleep_until_ns(70_000_000)
        frame = camera.read()
        dropped = camera.dropped

    assert int(frame.rgb[0, 0, 0]) == 25
    assert frame.stamp_ns == 66_666_667
    assert dropped == 1


def test_real_time_playback_times_out_like_a_camera(make: Make) -> None:
    config = FolderConfig(path=make(["1", "2"]), playback="realtime", fps=0.5)

    with FolderCamera(config, clock=ManualClock()) as camera:
        camera.read()
        with pytest.raises(StaleFrame, match="no new picture within 1 s"):
            camera.read(timeout_s=1.0)


def test_a_missing_camera_file_says_how_to_get_one(make: Make) -> None:
    folder = make(["1"], camera="")

    with pytest.raises(DataError) as caught, FolderCamera(FolderConfig(path=folder)):
        pass

    assert str(caught.value) == (
        f"{folder}: expected camera.toml with the intrinsics beside the pictures, found none; "
        "write one with `clothrf calibrate intrinsics`, or set camera_file"
    )


def test_calibration_pictures_need_neither_depth_nor_camera_file(make: Make) -> None:
    config = FolderConfig(
        path=make(["1"], camera="", depth=False), depth="optional", guess_intrinsics=True
    )

    with FolderCamera(config) as camera:
        frame = camera.read()

    assert np.isnan(frame.depth).all()
    assert frame.camera.K[0, 0] == 32


def test_missing_depth_is_named(make: Make) -> None:
    folder = make(["7"], depth=False)

    with (
        pytest.raises(DataError, match=r"expected 7_depth.png beside it, found none"),
        FolderCamera(FolderConfig(path=folder)),
    ):
        pass


def test_a_truncated_picture_is_named(make: Make) -> None:
    folder = make(["1"])
    path = folder / "1_depth.png"
    path.write_bytes(path.read_bytes()[:60])

    with (
        FolderCamera(FolderConfig(path=folder)) as camera,
        pytest.raises(DataError, match=r"1_depth.png: expected a whole picture, found a truncated"),
    ):
        camera.read()


def test_pictures_of_another_size_than_the_camera_file_are_refused(make: Make) -> None:
    folder = make(["1"], camera=CAMERA.replace("width = 32", "width = 64"))

    with (
        FolderCamera(FolderConfig(path=folder)) as camera,
        pytest.raises(DataError, match="expected 64 x 24 pixels as the camera file says"),
    ):
        camera.read()


def test_a_misspelt_key_of_a_camera_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.camera.toml"
    path.write_text(CAMERA + "distorsion = [0.1]\n")

    with pytest.raises(ConfigError, match=r"unknown key\. Did you mean 'distortion'"):
        read_camera_file(path)


def test_a_rotation_that_is_none_is_refused_by_the_camera_file(tmp_path: Path) -> None:
    path = tmp_path / "x.camera.toml"
    path.write_text(CAMERA.replace("[1.0,0.0,0.0,0.1]", "[1.2,0.0,0.0,0.1]"))

    with pytest.raises(ConfigError, match="expected a rotation matrix"):
        read_camera_file(path)


def test_the_registry_builds_the_folder_camera(make: Make) -> None:
    folder = make(["1"])

    with Registry.installed().build("camera", "folder", FolderConfig(path=folder)) as camera:
        assert camera.read().rgb.shape == (24, 32, 3)
