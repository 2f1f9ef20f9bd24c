"""``clothrf calibrate``: a few lines for every sub-command, over the library."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import typer
from rich.live import Live
from rich.table import Table

from clothrf_calibration.actions import check_backends, pose_pairs, positions_only, write_report
from clothrf_calibration.boardprint import write_board
from clothrf_calibration.boards import Board, parse_board
from clothrf_calibration.boardshape import SHAPES
from clothrf_calibration.camerafile import (
    intrinsics_tables,
    provenance,
    read_intrinsics,
    with_extrinsics,
    write_tables,
)
from clothrf_calibration.collect import PosedRobot
from clothrf_calibration.collect import Progress as CollectProgress
from clothrf_calibration.collect import collect as collect_pictures
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.handeye import hand_eye
from clothrf_calibration.images import find_images
from clothrf_calibration.inputs import (
    board_beside,
    build_component,
    depth_unit_of,
    known_board,
    parse_place,
    poses_of_pictures,
    predicted_boards,
    read_metres,
    read_rig,
    refuse_other_size,
    rig_camera,
    with_missing,
)
from clothrf_calibration.intrinsics import Options, calibrate
from clothrf_calibration.posefile import read_poses
from clothrf_calibration.practice import PracticeCamera
from clothrf_calibration.session import Session
from clothrf_calibration.simcamera import workspace_clip
from clothrf_calibration.singleshot import single_shot
from clothrf_calibration.terminal import (
    command_line,
    console,
    guidance,
    progress_bar,
    say,
    show_extrinsics,
    show_intrinsics,
    track,
    warn,
)
from clothrf_calibration.verify import verify as verify_views
from clothrf_calibration.views import load_views
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.types import Float

app = typer.Typer(
    name="calibrate",
    help="From a printed board to a camera file that says how good it is.",
    no_args_is_help=True,
    add_completion=False,
)
logger = logging.getLogger(__name__)

BoardOption = Annotated[
    str, typer.Option("--board", help="board file or line, e.g. charuco:10x7:25mm:18mm")
]
OutOption = Annotated[Path, typer.Option("--out", help="camera file to write (*.camera.toml)")]
ReplaceOption = Annotated[bool, typer.Option("--replace", help="replace an existing camera file")]
SetupOption = Annotated[
    str, typer.Option("--setup", help="fixed: camera stands, board on the gripper; hand: on it")
]


@app.command()
def board(
    text: Annotated[
        str, typer.Argument(help="charuco:10x7:25mm:18mm, chessboard:9x6:25mm, acircles:4x11:20mm")
    ] = "charuco:10x7:25mm:18mm:DICT_5X5_100",
    out: Annotated[Path, typer.Option("--out", help="folder to write into")] = Path(),
    paper: Annotated[str, typer.Option(help="A4, A3, A2, A1, A0, letter")] = "A4",
    dpi: Annotated[int, typer.Option(help="of the PNG")] = 300,
) -> None:
    """Write a printable board: PDF, PNG and its board file."""
    made = parse_board(text)
    for path in write_board(made, out, paper=paper, dpi=dpi):
        say(f"wrote {path}")
    say("Print at 100 %, check the ruler, measure ten squares and correct `square` in the file.")


@app.command()
def collect(
    out: Annotated[Path, typer.Option("--out", help="folder to fill; a second run goes on")],
    board: BoardOption = "",
    camera: Annotated[
        str, typer.Option(help="camera plugin: realsense, folder, raster")
    ] = "folder",
    options: Annotated[
        list[str] | None, typer.Option("--set", help="option of the camera, key=value")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="rig file (rendered cameras)")] = None,
    robot: Annotated[str, typer.Option(help="robot plugin whose poses are written down")] = "",
    robot_options: Annotated[
        list[str] | None, typer.Option("--robot-set", help="option of the robot, key=value")
    ] = None,
    gripper: Annotated[int, typer.Option(help="which gripper of the robot")] = 0,
    count: Annotated[int, typer.Option(help="pictures to keep")] = 25,
    every: Annotated[bool, typer.Option("--every", help="keep every picture with a board")] = False,
    seed: Annotated[int, typer.Option(help="of the practice pictures of a rendered camera")] = 0,
) -> None:
    """Take board pictures, guided by what is still missing; everything taken is kept.

    A rendered camera (raster, sapien) shows a board carried about, so that the procedure can be
    learnt without hardware.
    """
    registry = Registry.installed()
    made = board_beside(board, out)
    context = BuildContext(rig=read_rig(rig), registry=registry, folder=Path())
    source = build_component(registry, "camera", camera, options, context)
    unit = 0.001
    pose: Callable[[], Float] | None = None
    if hasattr(source, "render"):
        model = rig_camera(context.rig)
        unit = context.rig.camera.depth_unit if context.rig is not None else unit
        practice = PracticeCamera(
            source, model, made, np.random.default_rng(seed), count=2 * count + 10
        )
        source, pose, every = practice, practice.pose, True
    every = every or camera == "folder"
    arms = build_component(registry, "robot", robot, robot_options, context) if robot else None
    with source, Live(console=console(), refresh_per_second=8) as live:
        session = Session(out, made, depth_unit=float(getattr(source, "depth_unit", unit)))
        before = session.count
        if arms is not None:
            with arms:
                pose = _robot_pose(arms, gripper, robot)
                done = _collected(source, made, session, count, every, pose, live)
        else:
            done = _collected(source, made, session, count, every, pose, live)
    say(f"kept {done.kept} pictures in {out} ({before + done.kept} in all)")
    for line in done.advice:
        say(f"  still worth doing: {line}")
    say(f"next: clothrf calibrate intrinsics {out} --out my.camera.toml")


@app.command()
def intrinsics(
    pictures: Annotated[Path, typer.Argument(help="folder of pictures")],
    out: OutOption,
    board: BoardOption = "",
    model: Annotated[int | None, typer.Option(help="distortion coefficients: 0, 4, 5, 8")] = None,
    shape: Annotated[str | None, typer.Option(help="board: flat, warp, free")] = None,
    folds: Annotated[int, typer.Option(help="parts of the cross-validation")] = 5,
    report: Annotated[Path | None, typer.Option(help="also write this HTML page")] = None,
    replace: ReplaceOption = False,
) -> None:
    """Solve for the lens; models are chosen by pictures that were held out."""
    made = board_beside(board, pictures)
    if model not in (None, 0, 4, 5, 8) or shape not in (None, *SHAPES):
        raise CalibrationError(
            f"expected --model 0, 4, 5 or 8 and --shape flat, warp or free, got {model} and {shape}"
        )
    paths = find_images(pictures)
    loaded = load_views(paths, made, track=track)
    choice = Options(model, shape, folds)
    with progress_bar() as bar:
        task = bar.add_task("solving", total=None)
        result = calibrate(
            loaded.views, made, choice,
            step=lambda what, done, of: bar.update(
                task, description=what, completed=done, total=of
            ),
        )  # fmt: skip
        bar.update(task, description="solved", completed=1, total=1)
    beside = pictures / "camera.toml" if pictures.is_dir() else pictures
    unit = depth_unit_of(beside)
    tables = intrinsics_tables(
        result, command=command_line(), pictures=str(pictures), depth_unit=unit
    )
    tables["dropped"] = {**loaded.skipped, **tables["dropped"]}
    write_tables(out, tables, replace=replace)
    show_intrinsics(tables, out)
    if report is not None:
        write_report(out, pictures, report, None)


@app.command()
def extrinsics(
    pictures: Annotated[Path | None, typer.Argument(help="folder of pictures")] = None,
    camera: Annotated[Path | None, typer.Option(help="camera file with the intrinsics")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="camera file to write")] = None,
    poses: Annotated[Path | None, typer.Option(help="robot poses; default: poses.csv")] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(help="JSON of [T_base_gripper, T_camera_board] pairs, no pictures"),
    ] = None,
    place: Annotated[
        str | None, typer.Option(help="single shot: T_world_board as x,y,z,rx,ry,rz (m, rad)")
    ] = None,
    board: BoardOption = "",
    setup: SetupOption = "fixed",
    replace: ReplaceOption = False,
) -> None:
    """Solve for the camera pose: it stands, it is on the hand, one place of the board, pairs."""
    if setup not in ("fixed", "hand"):
        raise CalibrationError(f"expected --setup fixed or hand, got {setup}")
    if pairs is not None:
        pose_pairs(pairs, setup)
        return
    if pictures is None or camera is None or out is None:
        raise CalibrationError("expected PICTURES, --camera and --out (or --pairs); see --help")
    _, parameters, covariance, tables = read_intrinsics(camera)
    made, points = known_board(board, pictures, tables, camera)
    loaded = load_views(find_images(pictures), made, track=track)
    refuse_other_size(loaded.views, tables)
    if place is not None:
        T_world_board = parse_place(place)
        shot = single_shot(
            loaded.views, points, parameters, T_world_board, intrinsics_covariance=covariance
        )
        result = dict(tables)
        result["camera"] = {
            **tables["camera"], "T_world_camera": shot.T_world_camera.tolist()
        }  # fmt: skip
        result["extrinsics"] = {
            **provenance(command_line(), pictures=str(pictures)),
            "method": "board at a measured place",
            "T_world_camera": shot.T_world_camera.tolist(),
            "T_world_board": T_world_board.tolist(),
            "covariance": shot.covariance.tolist(),
            "sd_mm": 1e3 * float(np.sqrt(np.trace(shot.covariance[3:, 3:]))),
            "sd_deg": float(np.degrees(np.sqrt(np.trace(shot.covariance[:3, :3])))),
            "rms_px": shot.rms,
            "views": len(loaded.views),
        }
        result["warnings"] = {**tables.get("warnings", {}), "extrinsics": list(shot.warnings)}
    else:
        found = read_poses(poses or pictures / "poses.csv")
        if found.positions_only:
            result = positions_only(
                found, loaded.views, points, parameters, tables, str(pictures), setup
            )
            write_tables(out, result, replace=replace)
            show_extrinsics(result, out)
            return
        with progress_bar() as bar:
            task = bar.add_task("solving", total=8)
            solved = hand_eye(
                with_missing(loaded.views, pictures, found),
                poses_of_pictures(found, pictures), made, parameters,
                setup=cast("Literal['fixed', 'hand']", setup),
                covariance=covariance, points=points,
                step=lambda what, done, of: bar.update(
                    task, description=what, completed=done, total=of
                ),
            )  # fmt: skip
        result = with_extrinsics(
            tables, solved, command=command_line(), pictures=str(pictures),
            points=points, views=loaded.views,
        )  # fmt: skip
        result["warnings"]["extrinsics"] += list(found.notes)
    write_tables(out, result, replace=replace)
    show_extrinsics(result, out)


@app.command("sim-camera")
def sim_camera(
    camera: Annotated[Path, typer.Argument(help="camera file")],
    rig: Annotated[
        Path | None, typer.Option(help="rig file: its workspace sets near and far")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="camera file to write")] = None,
    check: Annotated[bool, typer.Option("--check", help="render a board and compare")] = False,
    backend: Annotated[
        list[str] | None, typer.Option(help="rendered cameras to check; all by default")
    ] = None,
    poses: Annotated[int, typer.Option(help="places of the board")] = 6,
    replace: ReplaceOption = False,
) -> None:
    """Make the rendered camera see what the real one sees, and prove it."""
    section, _, _, tables = read_intrinsics(camera)
    if rig is not None:
        workspace = read_rig(rig)
        assert workspace is not None
        near, far = workspace_clip(section.model(), workspace)
        section = section.model_copy(update={"near": near, "far": far})
        say(f"clip planes: near {near:.3f} m, far {far:.3f} m")
    if out is not None:
        result = dict(tables)
        result.setdefault("kind", "camera")
        result["camera"] = section.model_dump()
        result["sim_camera"] = provenance(command_line(), pictures="")
        write_tables(out, result, replace=replace)
        say(f'wrote {out}; use it in a rig with: camera = {{ file = "{out.name}" }}')
    if check:
        check_backends(section, backend, poses)


@app.command()
def verify(
    pictures: Annotated[Path, typer.Argument(help="folder of new pictures")],
    camera: Annotated[Path, typer.Option(help="camera file to judge")],
    board: BoardOption = "",
    poses: Annotated[Path | None, typer.Option(help="robot poses; default: poses.csv")] = None,
    seed: Annotated[int, typer.Option(help="of the bootstrap")] = 0,
) -> None:
    """Judge a camera file on pictures that were never used."""
    section, parameters, _, tables = read_intrinsics(camera)
    made, points = known_board(board, pictures, tables, camera)
    loaded = load_views(find_images(pictures), made, track=track)
    refuse_other_size(loaded.views, tables)
    if str(pictures) == tables.get("provenance", {}).get("pictures"):
        warn("these pictures made the camera file; new ones would prove more")
    depths = {
        v.name: read_metres(pictures / f"{v.name}_depth.png", section.depth_unit)
        for v in loaded.views
        if (pictures / f"{v.name}_depth.png").exists()
    }
    file = poses or pictures / "poses.csv"
    predicted = predicted_boards(file, loaded.views, tables) if file.exists() else None
    result = verify_views(
        loaded.views, points, parameters, depths=depths, predicted=predicted,
        rng=np.random.default_rng(seed),
    )  # fmt: skip
    table = Table("on pictures never used", "RMS  [95 % of bootstrap resamples]")
    for name, value in result.rows():
        table.add_row(name, value)
    console().print(table)
    fit = tables.get("residuals", {}).get("held_out_px")
    if fit is not None and result.reprojection_px.value > 2.0 * fit:
        warn(
            f"twice the {fit:.3f} px held out when it was made: refocused, another resolution, or "
            "the camera was bumped; calibrate again"
        )


@app.command()
def report(
    camera: Annotated[Path, typer.Argument(help="camera file")],
    out: Annotated[Path, typer.Option("--out", help="HTML page to write")],
    pictures: Annotated[
        Path | None, typer.Option(help="pictures; default: those it was made from")
    ] = None,
) -> None:
    """Write one HTML page with everything, pictures included."""
    tables = read_intrinsics(camera)[3]
    folder = pictures or Path(str(tables.get("provenance", {}).get("pictures", "")))
    write_report(camera, folder, out, tables)


def _collected(
    source: Any, made: Board, session: Session, count: int, every: bool,
    pose: Callable[[], Float] | None, live: Live,
) -> CollectProgress:  # fmt: skip
    return collect_pictures(
        source, made, session, wanted=count, every=every, pose=pose,
        tell=lambda state: live.update(guidance(state)),
    )  # fmt: skip


def _robot_pose(arms: Any, gripper: int, name: str) -> Callable[[], Float]:
    if isinstance(arms, PosedRobot):
        return lambda: np.asarray(arms.poses(), float)[gripper]
    warn(
        f"robot '{name}' tells where its grippers are but not how they are turned: only positions "
        "are written down, which makes the result several times less exact"
    )
    return lambda: np.asarray(arms.state().positions, float)[gripper]
