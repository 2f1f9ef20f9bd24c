"""The whole procedure as a new user meets it: print, collect, solve, verify, simulate, report."""

from __future__ import annotations

import shutil
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer.testing
from clothrf_calibration import rigid, synthetic
from clothrf_calibration.boards import parse_board
from clothrf_calibration.cli import app
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.images import write_png
from clothrf_calibration.lens import vector
from clothrf_calibration.posefile import csv_line
from clothrf_calibration.session import POSES_HEADER, Session
from clothrf_calibration.singleshot import single_shot
from clothrf_calibration.verify import verify

from clothrf_core.camera_file import read_camera_file
from clothrf_core.errors import ClothrfError
from clothrf_core.geometry import look_at
from clothrf_core.registry import Registry
from clothrf_core.types import RgbdFrame

RIG = Path(__file__).parents[2] / "configs" / "rigs" / "yumi_sr300.toml"
BOARD = "chessboard:9x6:25mm"


def run(*arguments: object) -> str:
    result = typer.testing.CliRunner().invoke(
        app, [str(a) for a in arguments], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: object) -> str:
    with pytest.raises(ClothrfError) as caught:
        typer.testing.CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with collected pictures and the camera files solved from them."""
    folder = tmp_path_factory.mktemp("calibrate")
    run("collect", "--out", folder / "cal", "--board", BOARD, "--camera", "raster",
        "--rig", RIG, "--count", 12)  # fmt: skip
    run("collect", "--out", folder / "new", "--board", BOARD, "--camera", "raster",
        "--rig", RIG, "--count", 5, "--seed", 9)  # fmt: skip
    run("intrinsics", folder / "cal", "--out", folder / "a.camera.toml", "--model", 0,
        "--shape", "flat", "--folds", 3)  # fmt: skip
    run("extrinsics", folder / "cal", "--camera", folder / "a.camera.toml", "--out",
        folder / "b.camera.toml")  # fmt: skip
    return folder


def test_the_refined_lens_states_its_own_uncertainty(work: Path, tmp_path: Path) -> None:
    lens, whole = (tomllib.loads((work / f"{n}.camera.toml").read_text()) for n in "ab")
    before, after = lens["uncertainty"], whole["uncertainty"]

    run("report", work / "b.camera.toml", "--pictures", work / "cal", "--out", tmp_path / "b.html")

    assert after["sd"][0] < before["sd"][0]
    assert after["projection_mean_px"] < before["projection_mean_px"]
    assert any("focal length" in w for w in lens["warnings"]["uncertainty"]) == (
        before["sd"][0] > 1e-3 * lens["camera"]["K"][0][0]
    )
    assert whole["warnings"]["uncertainty"] == []
    page = (tmp_path / "b.html").read_text()
    assert f"uncertain by {after['projection_mean_px']:.2f} px on average" in page


def test_the_calibrated_camera_is_the_one_that_took_the_pictures(work: Path) -> None:
    truth = tomllib.loads(RIG.read_text())["camera"]

    found = read_camera_file(work / "b.camera.toml")

    K, T = np.array(found.K), np.array(found.T_world_camera)
    true = np.array(truth["T_world_camera"])
    assert np.abs(K - truth["K"]).max() < 1.0
    assert 1e3 * np.linalg.norm(T[:3, 3] - true[:3, 3]) < 0.5
    assert rigid.angle_deg(T[:3, :3] @ true[:3, :3].T) < 0.05
    assert found.depth_unit == truth["depth_unit"]


def test_the_camera_file_says_how_it_was_made_and_how_good_it_is(work: Path) -> None:
    tables = tomllib.loads((work / "b.camera.toml").read_text())

    assert tables["provenance"]["board"] == BOARD
    assert {"command", "date", "clothrf", "opencv", "numpy", "detector"} <= set(
        tables["provenance"]
    )
    assert tables["uncertainty"]["names"] == ["fx", "fy", "cx", "cy"]
    assert np.array(tables["uncertainty"]["covariance"]).shape == (4, 4)
    assert len(tables["residuals"]["views"]) == 12
    assert 0 < tables["residuals"]["held_out_px"] < 0.3
    assert np.array(tables["extrinsics"]["T_base_camera"]).shape == (4, 4)
    assert 0 < tables["extrinsics"]["held_out_mm"] < 0.5


def test_new_pictures_confirm_it(work: Path) -> None:
    output = run("verify", work / "new", "--camera", work / "b.camera.toml")

    for name in ("reprojection error", "3-D points", "depth bias", "board, seen against"):
        assert name in output


def test_verifying_with_the_same_pictures_is_warned_of(work: Path) -> None:
    output = run("verify", work / "cal", "--camera", work / "b.camera.toml")

    assert "these pictures made the camera file; new ones would prove more" in output


def test_the_simulated_camera_agrees_with_the_calibrated_one(work: Path) -> None:
    out = work / "sim.camera.toml"

    output = run("sim-camera", work / "b.camera.toml", "--rig", RIG, "--out", out, "--check",
                 "--backend", "raster", "--poses", 2)  # fmt: skip

    assert "good" in output
    section = read_camera_file(out)
    assert section.near < 0.3
    assert 1.0 < section.far < 2.0


def test_the_report_is_one_page_with_its_pictures_inside(work: Path) -> None:
    out = work / "report.html"

    run("report", work / "b.camera.toml", "--out", out)

    page = out.read_text()
    assert page.count("data:image/png;base64,") == 5
    assert "http" not in page
    assert "A low residual alone proves nothing" in page


def test_an_existing_camera_file_is_not_replaced_unasked(work: Path) -> None:
    message = refused("intrinsics", work / "cal", "--out", work / "a.camera.toml", "--model", 0,
                      "--shape", "flat", "--folds", 2)  # fmt: skip

    assert message == (
        f"{work / 'a.camera.toml'}: expected no file of that name, found one; choose another "
        "--out or say --replace"
    )


def test_collecting_again_goes_on_and_keeps_what_is_there(work: Path, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    shutil.copytree(work / "new", folder)
    before = {p.name: p.read_bytes() for p in folder.glob("*.png")}

    run("collect", "--out", folder, "--board", BOARD, "--camera", "folder", "--set",
        f"path={work / 'cal'}", "--count", 2)  # fmt: skip

    after = {p.name: p.read_bytes() for p in folder.glob("*.png")}
    assert all(after[name] == data for name, data in before.items())
    assert len(list(folder.glob("*_color.png"))) == 7
    assert (folder / "poses.csv").read_text() == (work / "new" / "poses.csv").read_text()


def test_another_board_does_not_get_into_a_session(work: Path) -> None:
    with pytest.raises(CalibrationError, match="take another folder"):
        Session(work / "cal", parse_board("chessboard:8x5:30mm"))


def test_a_missing_board_is_said(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.full((480, 640), 90, np.uint8))

    message = refused("intrinsics", tmp_path, "--out", tmp_path / "x.camera.toml")

    assert message == (
        f"expected --board (for example --board chessboard:9x6:25mm) or {tmp_path}/board.toml, "
        "found neither"
    )


def test_an_empty_folder_is_said(tmp_path: Path) -> None:
    message = refused("intrinsics", tmp_path, "--board", BOARD, "--out", tmp_path / "x.toml")

    assert "expected pictures" in message
    assert message.endswith("found none; take some with `clothrf calibrate collect`")


def test_pictures_of_another_size_are_refused_by_extrinsics(work: Path, data: Path) -> None:
    small = work / "small"
    small.mkdir(exist_ok=True)
    image = cv2.imread(filename=str(data / "opencv_left" / "left01.jpg"))
    half = cv2.resize(src=image, dsize=(1280, 960))
    cv2.imwrite(filename=str(small / "0001_color.png"), img=half)

    message = refused("extrinsics", small, "--camera", work / "a.camera.toml", "--board", BOARD,
                      "--out", work / "c.toml")  # fmt: skip

    assert message == (
        "expected pictures of 640 x 480 as the camera file says, found 1280 x 960; intrinsics "
        "hold for one resolution only"
    )


def test_fewer_poses_than_pictures_are_refused(work: Path, tmp_path: Path) -> None:
    poses = tmp_path / "p.csv"
    lines = (work / "cal" / "poses.csv").read_text().splitlines()
    poses.write_text("\n".join(line.partition(",")[2] for line in lines[:-3]) + "\n")

    message = refused("extrinsics", work / "cal", "--camera", work / "a.camera.toml", "--poses",
                      poses, "--out", tmp_path / "c.toml")  # fmt: skip

    assert message == (
        "expected a pose for every picture, found 12 pictures and 9 poses; give every pose the "
        "name of its picture"
    )


def test_a_board_at_a_measured_place_gives_the_camera(work: Path, tmp_path: Path) -> None:
    folder = tmp_path / "place"
    folder.mkdir()
    shutil.copy(work / "cal" / "0001_color.png", folder)
    shutil.copy(work / "cal" / "board.toml", folder)
    row = (work / "cal" / "poses.csv").read_text().splitlines()[1].split(",")
    tables = tomllib.loads((work / "b.camera.toml").read_text())
    G = np.eye(4)
    x, y, z, qx, qy, qz, qw = (float(v) for v in row[1:])
    angle = 2 * np.arctan2(np.linalg.norm([qx, qy, qz]), qw)
    G[:3, :3] = rigid.exp(np.array([qx, qy, qz]) / np.linalg.norm([qx, qy, qz]) * angle)
    G[:3, 3] = [x, y, z]
    B = G @ np.array(tables["extrinsics"]["T_gripper_board"])
    place = ",".join(f"{v:.9f}" for v in (*B[:3, 3], *rigid.log(B[:3, :3])))

    output = run("extrinsics", folder, "--camera", work / "b.camera.toml", f"--place={place}",
                 "--out", tmp_path / "s.camera.toml")  # fmt: skip

    T = np.array(read_camera_file(tmp_path / "s.camera.toml").T_world_camera)
    true = np.array(tables["camera"]["T_world_camera"])
    assert 1e3 * np.linalg.norm(T[:3, 3] - true[:3, 3]) < 5.0
    assert "30 of the same board average the noise out" in output


def test_gripper_positions_alone_place_a_standing_camera(work: Path, tmp_path: Path) -> None:
    poses = tmp_path / "positions.csv"
    lines = (work / "cal" / "poses.csv").read_text().splitlines()
    poses.write_text("\n".join(",".join(line.split(",")[:4]) for line in lines) + "\n")
    true = np.array(tomllib.loads(RIG.read_text())["camera"]["T_world_camera"])

    output = run("extrinsics", work / "cal", "--camera", work / "a.camera.toml", "--poses", poses,
                 "--out", tmp_path / "p.camera.toml")  # fmt: skip

    T = np.array(read_camera_file(tmp_path / "p.camera.toml").T_world_camera)
    assert 1e3 * np.linalg.norm(T[:3, 3] - true[:3, 3]) < 5.0
    assert "solved from gripper positions only" in output


def test_a_robot_plugin_that_tells_positions_only_is_written_down(
    tmp_path: Path, work: Path
) -> None:
    session = Session(tmp_path / "s", parse_board(BOARD))
    frame = RgbdFrame(
        stamp_ns=1,
        rgb=np.zeros((480, 640, 3), np.uint8),
        depth=np.full((480, 640), np.nan, np.float32),
        camera=synthetic.camera(),
    )

    session.add(frame, np.array([0.1, 0.2, 0.3]))

    assert (tmp_path / "s" / "poses.csv").read_text() == "name,x,y,z\n0001,0.1,0.2,0.3\n"
    with pytest.raises(CalibrationError, match="take another folder"):
        session.add(frame, np.eye(4))


def test_a_place_in_millimetres_is_refused(work: Path, tmp_path: Path) -> None:
    message = refused("extrinsics", work / "cal", "--camera", work / "b.camera.toml",
                      "--place", "400,0,100,0,0,1.57", "--out", tmp_path / "s.toml")  # fmt: skip

    assert message == (
        "--place: expected metres and radians, got 400,0,100,0,0,1.57; that looks like "
        "millimetres or degrees"
    )


def test_pose_pairs_alone_are_solved(data: Path) -> None:
    output = run("extrinsics", "--pairs", data / "moveit_handeye" / "pose_samples.json")

    assert "held out (5 folds): 4.75 mm, 0.093 degrees RMS" in output


def test_the_command_is_found_by_the_registry() -> None:
    names = [c.name for c in Registry.installed().commands]

    assert "calibrate" in names


# Single shot and verification against truth.


def test_the_stated_uncertainty_of_a_single_shot_is_right() -> None:
    board = parse_board("charuco:10x7:25mm:18mm")
    model = synthetic.camera()
    parameters = vector(model.K, model.distortion)
    X = look_at(np.array([0.8, 0.0, 0.6]), np.array([0.5, 0.0, 0.1]))
    inside = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        C = synthetic.board_poses(rng, board, 1, tilt=0.6, spread=0.0)
        views = synthetic.views(rng, board, model, np.repeat(C, 5, axis=0))
        error = np.eye(4)
        error[:3, :3] = rigid.exp(np.radians(0.1) * rng.normal(size=3))
        error[:3, 3] = 5e-4 * rng.normal(size=3)
        told = X @ C[0]
        told[:3, :3] = error[:3, :3] @ told[:3, :3]
        told[:3, 3] += error[:3, 3]

        shot = single_shot(views, board.points, parameters, told)
        d = shot.T_world_camera @ rigid.inverse(X)
        x = np.concatenate([rigid.log(d[:3, :3]), shot.T_world_camera[:3, 3] - X[:3, 3]])
        inside += int(x @ np.linalg.solve(shot.covariance, x) < 12.592)

    # 51 of 60 or fewer has a chance of 0.6 % at 95 %.
    assert inside >= 52


def test_a_wrong_depth_scale_is_measured() -> None:
    board = parse_board("charuco:10x7:25mm:18mm")
    model = synthetic.camera(distortion=())
    rng = np.random.default_rng(0)
    T = synthetic.board_poses(rng, board, 12, tilt=0.3)
    views = synthetic.views(rng, board, model, T, noise=0.05)
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    ray = np.stack([(u - model.K[0, 2]) / model.K[0, 0], (v - model.K[1, 2]) / model.K[1, 1],
                    np.ones_like(u)], axis=-1)  # fmt: skip
    depths = {
        view.name: (1.01 * (t[:3, 2] @ t[:3, 3]) / (ray @ t[:3, 2])).astype(np.float32)
        for view, t in zip(views, T, strict=True)
    }
    seen = [view for view in views if len(view.ids) >= 12]

    result = verify(seen, board.points, vector(model.K, np.zeros(0)), depths=depths, rng=rng)

    assert result.depth_scale == pytest.approx(1.01, abs=1e-3)
    assert result.depth_bias_mm is not None
    assert 3.0 < result.depth_bias_mm.value < 8.0


def test_verification_of_a_bumped_camera_shows_in_millimetres() -> None:
    board = parse_board("charuco:10x7:20mm:14mm")
    model = synthetic.camera()
    rig = synthetic.hand_eye_rig(np.random.default_rng(0), board, model, 10)
    bumped = np.array(rig.X)
    bumped[:3, 3] += [0.01, 0.0, 0.0]
    seen = [v for v in rig.views if len(v.ids) >= 8]
    predicted = {
        v.name: rigid.inverse(bumped) @ rig.T_base_gripper[n] @ rig.Z
        for n, v in enumerate(rig.views)
    }

    result = verify(seen, board.points, vector(model.K, model.distortion), predicted=predicted,
                    rng=np.random.default_rng(0))  # fmt: skip

    assert result.hand_eye_mm is not None
    assert result.hand_eye_mm.value == pytest.approx(10.0, abs=0.5)


def test_a_session_never_leaves_a_picture_without_its_pose(tmp_path: Path) -> None:
    board = parse_board(BOARD)
    session = Session(tmp_path, board)
    model = synthetic.camera()
    frame = RgbdFrame(
        stamp_ns=1,
        rgb=np.zeros((480, 640, 3), np.uint8),
        depth=np.full((480, 640), 0.5, np.float32),
        camera=model,
    )

    session.add(frame, np.eye(4))
    session.add(frame, np.eye(4))

    names = [p.name.removesuffix("_color.png") for p in sorted(tmp_path.glob("*_color.png"))]
    assert (tmp_path / "poses.csv").read_text() == POSES_HEADER + "".join(
        csv_line(n, np.eye(4)) for n in names
    )
    assert Session(tmp_path, board).add(frame) == "0003"
