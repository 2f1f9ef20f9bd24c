"""``clothrf calibrate``: a few lines for every sub-command, over the library."""

from __future__ import annotations

import logging
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import typer
from pydantic import ValidationError
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from clothrf_calibration import rigid
from clothrf_calibration.boardprint import write_board
from clothrf_calibration.boards import Board, parse_board, read_board
from clothrf_calibration.boardshape import SHAPES, Shape, deformed, shape_basis
from clothrf_calibration.camerafile import (
    board_of_tables,
    intrinsics_tables,
    provenance,
    read_intrinsics,
    with_extrinsics,
    write_tables,
)
from clothrf_calibration.collect import PosedRobot
from clothrf_calibration.collect import Progress as CollectProgress
from clothrf_calibration.collect import collect as collect_pictures
from clothrf_calibration.coverage import meter
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.handeye import hand_eye
from clothrf_calibration.handeye_points import fit_points
from clothrf_calibration.handeye_poses import fit_poses, held_out_poses
from clothrf_calibration.images import find_images, read_counts
from clothrf_calibration.intrinsics import Options, calibrate
from clothrf_calibration.intrinsics_fit import fit_pose
from clothrf_calibration.posefile import Poses, match, read_poses
from clothrf_calibration.practice import PracticeCamera
from clothrf_calibration.report import report as report_page
from clothrf_calibration.session import Session
from clothrf_calibration.simcamera import check, check_poses, workspace_clip
from clothrf_calibration.singleshot import single_shot
from clothrf_calibration.verify import verify as verify_views
from clothrf_calibration.views import View, load_views, view_name
from clothrf_core.errors import ConfigError
from clothrf_core.files import atomic_write
from clothrf_core.provider import BuildContext
from clothrf_core.registry import Registry
from clothrf_core.rig import CameraSection, Rig
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
        _say(f"wrote {path}")
    _say("Print at 100 %, check the ruler, measure ten squares and correct `square` in the file.")


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
    made = _board(board, out)
    context = BuildContext(rig=_rig(rig), registry=registry, folder=Path())
    source = _component(registry, "camera", camera, options, context)
    unit = 0.001
    pose: Callable[[], Float] | None = None
    if hasattr(source, "render"):
        model = _rig_camera(context.rig)
        unit = context.rig.camera.depth_unit if context.rig is not None else unit
        practice = PracticeCamera(
            source, model, made, np.random.default_rng(seed), count=2 * count + 10
        )
        source, pose, every = practice, practice.pose, True
    every = every or camera == "folder"
    arms = _component(registry, "robot", robot, robot_options, context) if robot else None
    with source, Live(console=_console(), refresh_per_second=8) as live:
        session = Session(out, made, depth_unit=float(getattr(source, "depth_unit", unit)))
        before = session.count
        if arms is not None:
            with arms:
                pose = _robot_pose(arms, gripper, robot)
                done = _collected(source, made, session, count, every, pose, live)
        else:
            done = _collected(source, made, session, count, every, pose, live)
    _say(f"kept {done.kept} pictures in {out} ({before + done.kept} in all)")
    for line in done.advice:
        _say(f"  still worth doing: {line}")
    _say(f"next: clothrf calibrate intrinsics {out} --out my.camera.toml")


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
    made = _board(board, pictures)
    if model not in (None, 0, 4, 5, 8) or shape not in (None, *SHAPES):
        raise CalibrationError(
            f"expected --model 0, 4, 5 or 8 and --shape flat, warp or free, got {model} and {shape}"
        )
    paths = find_images(pictures)
    loaded = load_views(paths, made, track=_track)
    choice = Options(model, shape, folds)
    with _bar() as bar:
        task = bar.add_task("solving", total=None)
        result = calibrate(
            loaded.views, made, choice,
            step=lambda what, done, of: bar.update(
                task, description=what, completed=done, total=of
            ),
        )  # fmt: skip
        bar.update(task, description="solved", completed=1, total=1)
    beside = pictures / "camera.toml" if pictures.is_dir() else pictures
    unit = _depth_unit(beside)
    tables = intrinsics_tables(result, command=_command(), pictures=str(pictures), depth_unit=unit)
    tables["dropped"] = {**loaded.skipped, **tables["dropped"]}
    write_tables(out, tables, replace=replace)
    _show_intrinsics(tables, out)
    if report is not None:
        _write_report(out, pictures, report, None)


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
        _from_pairs(pairs, setup)
        return
    if pictures is None or camera is None or out is None:
        raise CalibrationError("expected PICTURES, --camera and --out (or --pairs); see --help")
    _, parameters, covariance, tables = read_intrinsics(camera)
    made, points = _known_board(board, pictures, tables, camera)
    loaded = load_views(find_images(pictures), made, track=_track)
    _same_size(loaded.views, tables)
    if place is not None:
        T_world_board = _place(place)
        shot = single_shot(
            loaded.views, points, parameters, T_world_board, intrinsics_covariance=covariance
        )
        result = dict(tables)
        result["camera"] = {
            **tables["camera"], "T_world_camera": shot.T_world_camera.tolist()
        }  # fmt: skip
        result["extrinsics"] = {
            **provenance(_command(), pictures=str(pictures)),
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
            result = _from_positions(
                found, loaded.views, points, parameters, tables, str(pictures), setup
            )
            write_tables(out, result, replace=replace)
            _show_extrinsics(result, out)
            return
        with _bar() as bar:
            task = bar.add_task("solving", total=8)
            solved = hand_eye(
                _with_missing(loaded.views, pictures, found), _robot(found, pictures), made,
                parameters, setup=cast("Literal['fixed', 'hand']", setup),
                covariance=covariance, points=points,
                step=lambda what, done, of: bar.update(
                    task, description=what, completed=done, total=of
                ),
            )  # fmt: skip
        result = with_extrinsics(tables, solved, command=_command(), pictures=str(pictures))
        result["warnings"]["extrinsics"] += list(found.notes)
    write_tables(out, result, replace=replace)
    _show_extrinsics(result, out)


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
        workspace = _rig(rig)
        assert workspace is not None
        near, far = workspace_clip(section.model(), workspace)
        section = section.model_copy(update={"near": near, "far": far})
        _say(f"clip planes: near {near:.3f} m, far {far:.3f} m")
    if out is not None:
        result = dict(tables)
        result.setdefault("kind", "camera")
        result["camera"] = section.model_dump()
        result["sim_camera"] = provenance(_command(), pictures="")
        write_tables(out, result, replace=replace)
        _say(f'wrote {out}; use it in a rig with: camera = {{ file = "{out.name}" }}')
    if check:
        _check(section, backend, poses)


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
    made, points = _known_board(board, pictures, tables, camera)
    loaded = load_views(find_images(pictures), made, track=_track)
    _same_size(loaded.views, tables)
    if str(pictures) == tables.get("provenance", {}).get("pictures"):
        _warn("these pictures made the camera file; new ones would prove more")
    depths = {
        v.name: _metres(pictures / f"{v.name}_depth.png", section.depth_unit)
        for v in loaded.views
        if (pictures / f"{v.name}_depth.png").exists()
    }
    file = poses or pictures / "poses.csv"
    predicted = _predicted(file, loaded.views, tables) if file.exists() else None
    result = verify_views(
        loaded.views, points, parameters, depths=depths, predicted=predicted,
        rng=np.random.default_rng(seed),
    )  # fmt: skip
    table = Table("on pictures never used", "RMS  [95 % of bootstrap resamples]")
    for name, value in result.rows():
        table.add_row(name, value)
    _console().print(table)
    fit = tables.get("residuals", {}).get("held_out_px")
    if fit is not None and result.reprojection_px.value > 2.0 * fit:
        _warn(
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
    _write_report(camera, folder, out, tables)


def _write_report(camera: Path, pictures: Path, out: Path, tables: dict[str, Any] | None) -> None:
    section, _, _, found = read_intrinsics(camera)
    tables = tables or found
    made, shape, numbers = board_of_tables(tables, camera)
    loaded = load_views(find_images(pictures), made, track=_track)
    grippers = None
    if (pictures / "poses.csv").exists():
        grippers = match(read_poses(pictures / "poses.csv"), [v.name for v in loaded.views])
    page = report_page(
        section, tables, made, shape, numbers, loaded.views, title=camera.name, grippers=grippers
    )
    atomic_write(out, page.encode())
    _say(f"wrote {out}")


def _from_pairs(path: Path, setup: str) -> None:
    found = read_poses(path)
    if found.T_camera_board is None:
        raise CalibrationError(f"{path}: expected pairs of 4 x 4 matrices, found single ones")
    G = found.T_base_gripper
    A = G if setup == "fixed" else rigid.inverse(G)
    result = fit_poses(A, found.T_camera_board)
    mm, deg = held_out_poses(A, found.T_camera_board)
    outer = "T_base_camera" if setup == "fixed" else "T_gripper_camera"
    _say(f"{outer} =\n{np.array2string(result.X, precision=6, suppress_small=True)}")
    sd = np.sqrt(np.diag(result.X_covariance))
    _say(f"one standard deviation: {1e3 * np.linalg.norm(sd[3:]):.2f} mm, "
         f"{np.degrees(np.linalg.norm(sd[:3])):.3f} degrees")  # fmt: skip
    _say(f"held out (5 folds): {np.sqrt((mm**2).mean()):.2f} mm, "
         f"{np.sqrt((deg**2).mean()):.3f} degrees RMS")  # fmt: skip
    for n in np.nonzero(result.weights < 0.2)[0]:
        _warn(f"pair {n} does not fit the others ({result.shift[n]:.1f} mm, "
              f"{result.turn[n]:.2f} degrees)")  # fmt: skip


def _from_positions(
    found: Poses, views: list[View], points: Float, parameters: Float, tables: dict[str, Any],
    pictures: str, setup: str,
) -> dict[str, Any]:  # fmt: skip
    if setup != "fixed":
        raise CalibrationError(
            "positions alone place a standing camera only; a camera on the hand needs full poses"
        )
    p = match(found, [v.name for v in views])[:, :3, 3]
    C = np.stack([fit_pose(parameters, points, v)[0] for v in views])
    solved = fit_points(p, C)
    result = dict(tables)
    result["camera"] = {**tables["camera"], "T_world_camera": solved.T_base_camera.tolist()}
    result["extrinsics"] = {
        **provenance(_command(), pictures=pictures),
        "method": "gripper positions without rotations",
        "T_base_camera": solved.T_base_camera.tolist(),
        "gripper_in_board": solved.point.tolist(),
        "covariance": solved.covariance.tolist(),
        "sd_mm": 1e3 * float(np.sqrt(np.trace(solved.covariance[3:, 3:]))),
        "sd_deg": float(np.degrees(np.sqrt(np.trace(solved.covariance[:3, :3])))),
        "fit_mm": float(np.sqrt((solved.residual_mm**2).mean())),
        "held_out_positions_mm": float(np.sqrt((solved.held_out_mm**2).mean())),
        "views": len(views),
    }
    result["warnings"] = {**tables.get("warnings", {}), "extrinsics": list(solved.warnings)}
    return result


def _check(section: CameraSection, backends: list[str] | None, poses: int) -> None:
    registry = Registry.installed()
    model = section.model()
    trial = Board(kind="chessboard", columns=9, rows=6, square=0.025)
    names = backends or [n for n in ("raster", "sapien") if n in registry.names("camera")]
    table = Table("rendered by", "corners", "RMS px", "mean offset px", "depth mm (99.9 %)", "")
    good = True
    for name in _tracked(names, "rendering"):
        renderer = registry.build("camera", name)
        if not hasattr(renderer, "render"):
            raise CalibrationError(f"camera '{name}' renders nothing; expected raster or sapien")
        with renderer:
            found = check(name, renderer, model, trial, check_poses(model, trial, poses))
        good &= found.good
        table.add_row(
            name, str(found.corners), f"{found.rms_px:.3f}",
            f"{found.mean_px[0]:+.3f} {found.mean_px[1]:+.3f}", f"{found.depth_worst_mm:.3f}",
            "good" if found.good else "BAD",
        )  # fmt: skip
    _console().print(table)
    if not good:
        raise CalibrationError(
            "expected rendered corners within 0.1 px and depth within 1 mm of the calibrated "
            "camera, found more; see the table"
        )


def _collected(
    source: Any, made: Board, session: Session, count: int, every: bool,
    pose: Callable[[], Float] | None, live: Live,
) -> CollectProgress:  # fmt: skip
    return collect_pictures(
        source, made, session, wanted=count, every=every, pose=pose,
        tell=lambda state: live.update(_guidance(state)),
    )  # fmt: skip


def _guidance(state: CollectProgress) -> Group:
    lines = [Text(f"{state.kept} of {state.wanted} pictures   {state.last}", style="bold")]
    if state.seen is not None:
        lines += [Text("  " + row, style="green") for row in meter(state.seen.cells)]
        lines.append(
            Text(f"  covered {100 * state.seen.share:.0f} %, tilt spread {state.seen.spread:.0f}°")
        )
    lines += [Text(f"  -> {line}", style="yellow") for line in state.advice[:3]]
    return Group(*lines)


def _robot_pose(arms: Any, gripper: int, name: str) -> Callable[[], Float]:
    if isinstance(arms, PosedRobot):
        return lambda: np.asarray(arms.poses(), float)[gripper]
    _warn(
        f"robot '{name}' tells where its grippers are but not how they are turned: only positions "
        "are written down, which makes the result several times less exact"
    )
    return lambda: np.asarray(arms.state().positions, float)[gripper]


def _board(text: str, folder: Path) -> Board:
    if text:
        return parse_board(text)
    beside = (folder if folder.is_dir() else folder.parent) / "board.toml"
    if beside.exists():
        return read_board(beside)
    raise CalibrationError(
        f"expected --board (for example --board chessboard:9x6:25mm) or {beside}, found neither"
    )


def _known_board(
    text: str, pictures: Path, tables: dict[str, Any], camera: Path
) -> tuple[Board, Float]:
    """The board of new pictures; its true shape if it is the one the camera file was made with."""
    if "board" in tables:
        made, shape, numbers = board_of_tables(tables, camera)
        beside = (pictures if pictures.is_dir() else pictures.parent) / "board.toml"
        other = parse_board(text) if text else read_board(beside) if beside.exists() else made
        if other.text == made.text:
            known: Shape = next((s for s in SHAPES if s == shape), "flat")
            return made, deformed(made, shape_basis(made, known), numbers)
        return other, other.points
    made = _board(text, pictures)
    return made, made.points


def _with_missing(views: list[View], pictures: Path, found: Poses) -> list[View]:
    """A view for every picture that has a pose; empty where no board was found."""
    names = [view_name(p) for p in find_images(pictures)]
    known = {v.name: v for v in views}
    empty = View("", views[0].size, np.zeros(0, np.int64), np.zeros((0, 2)))
    wanted = names if not found.names else [n for n in names if n in set(found.names)] or names
    return [known.get(n, View(n, empty.size, empty.ids, empty.pixels)) for n in wanted]


def _robot(found: Poses, pictures: Path) -> Float:
    names = [view_name(p) for p in find_images(pictures)]
    if found.names:
        here = [n for n in names if n in set(found.names)]
        missing = [n for n in names if n not in set(found.names)]
        for name in missing:
            _warn(f"{name} has no pose and is left out")
        names = here or names
    return match(found, names)


def _predicted(file: Path, views: list[View], tables: dict[str, Any]) -> dict[str, Float] | None:
    e = tables.get("extrinsics", {})
    found = read_poses(file)
    if not found.names or "setup" not in e:
        return None
    rows = dict(zip(found.names, found.T_base_gripper, strict=True))
    if e["setup"] == "fixed":
        X, Z = np.array(e["T_base_camera"], float), np.array(e["T_gripper_board"], float)
        return {v.name: rigid.inverse(X) @ rows[v.name] @ Z for v in views if v.name in rows}
    X, Z = np.array(e["T_gripper_camera"], float), np.array(e["T_base_board"], float)
    return {
        v.name: rigid.inverse(X) @ rigid.inverse(rows[v.name]) @ Z for v in views if v.name in rows
    }


def _same_size(views: list[View], tables: dict[str, Any]) -> None:
    wanted = (tables["camera"]["width"], tables["camera"]["height"])
    if views[0].size != wanted:
        raise CalibrationError(
            f"expected pictures of {wanted[0]} x {wanted[1]} as the camera file says, found "
            f"{views[0].size[0]} x {views[0].size[1]}; intrinsics hold for one resolution only"
        )


def _place(text: str) -> Float:
    try:
        numbers = np.array([float(n) for n in text.split(",")])
    except ValueError as error:
        raise CalibrationError(f"--place: expected x,y,z,rx,ry,rz, got '{text}'") from error
    if numbers.size != 6:
        raise CalibrationError(f"--place: expected six numbers x,y,z,rx,ry,rz, got {numbers.size}")
    if np.linalg.norm(numbers[:3]) > 10 or np.abs(numbers[3:]).max() > 2.05 * np.pi:
        raise CalibrationError(
            f"--place: expected metres and radians, got {text}; that looks like millimetres or "
            "degrees"
        )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rigid.exp(numbers[3:]), numbers[:3]
    return T


def _rig(path: Path | None) -> Rig | None:
    if path is None:
        return None
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
        if isinstance(tree.get("camera"), dict) and "file" in tree["camera"]:
            file = path.parent / str(tree["camera"].pop("file"))
            tree["camera"] = {**read_intrinsics(file)[0].model_dump(), **tree["camera"]}
        return Rig.model_validate(tree)
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: expected a rig file, found none") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: expected TOML ({error})") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{path}: {where}: {first['msg']}") from error


def _rig_camera(rig: Rig | None) -> Any:
    if rig is None:
        raise CalibrationError("a rendered camera needs --rig, which says where it stands")
    return rig.camera.model()


def _component(
    registry: Registry, kind: str, name: str, options: list[str] | None, context: BuildContext
) -> Any:
    config = registry.find(kind, name).config
    values: dict[str, Any] = {}
    for text in options or []:
        key, _, value = text.partition("=")
        try:
            values[key] = tomllib.loads(f"v = {value}")["v"]
        except tomllib.TOMLDecodeError:
            values[key] = value
    if kind == "camera" and name == "folder":
        values = {"depth": "optional", "guess_intrinsics": True, **values}
    try:
        return registry.build(kind, name, config.model_validate(values), context)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"{kind} '{name}': {'.'.join(map(str, first['loc']))}: {first['msg']}; pass it with "
            "--set key=value"
        ) from error


def _depth_unit(path: Path) -> float:
    if path.suffix != ".toml" or not path.exists():
        return 0.001
    return float(read_intrinsics(path)[0].depth_unit)


def _metres(path: Path, unit: float) -> Any:
    counts = read_counts(path)
    depth = counts.astype(np.float32) * np.float32(unit)
    depth[counts == 0] = np.nan
    return depth


def _show_intrinsics(tables: dict[str, Any], out: Path) -> None:
    u, r = tables["uncertainty"], tables["residuals"]
    c = tables["camera"]
    values = [c["K"][0][0], c["K"][1][1], c["K"][0][2], c["K"][1][2], *c["distortion"]]
    table = Table("", "value", "one sd")
    for name, value, sd in zip(u["names"], values, u["sd"], strict=True):
        table.add_row(name, f"{value:.5g}" if abs(value) < 10 else f"{value:.2f}", f"{sd:.2g}")
    _console().print(table)
    held = (
        f", held out {r['held_out_px']:.3f} ± {r['held_out_spread_px']:.3f} px"
        if "held_out_px" in r else ""
    )  # fmt: skip
    _say(
        f"residual {r['rms_px']:.3f} px over {r['corners'] - r['rejected']} corners "
        f"({r['rejected']} rejected){held}; projections uncertain by "
        f"{u['projection_mean_px']:.2f} px on average, {u['projection_worst_px']:.2f} px at worst"
    )
    for name, why in tables["dropped"].items():
        _warn(f"{name} was left out: {why}")
    for line in tables["warnings"]["intrinsics"]:
        _warn(line)
    _say(f"wrote {out}")


def _show_extrinsics(tables: dict[str, Any], out: Path) -> None:
    e = tables["extrinsics"]
    for name in (k for k in e if k.startswith("T_")):
        _say(f"{name} =\n{np.array2string(np.array(e[name]), precision=6, suppress_small=True)}")
    fit = f"{e['rms_px']:.3f} px" if "rms_px" in e else f"{e['fit_mm']:.2f} mm"
    _say(f"camera pose +- {e['sd_mm']:.2f} mm, {e['sd_deg']:.4f} degrees; fit {fit}")
    if "held_out_mm" in e:
        _say(
            f"held out: {e['held_out_px']:.3f} px, {e['held_out_mm']:.2f} ± "
            f"{e['held_out_spread_mm']:.2f} mm, {e['held_out_deg']:.3f} degrees"
        )
    for line in tables["warnings"]["extrinsics"]:
        _warn(line)
    _say(f"wrote {out}")


def _bar() -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=_console(),
    )  # fmt: skip


def _track(paths: Iterable[Path], count: int) -> Iterator[Path]:
    with _bar() as bar:
        yield from bar.track(paths, total=count, description="finding the board")


def _tracked(names: list[str], what: str) -> Iterator[str]:
    with _bar() as bar:
        yield from bar.track(names, total=len(names), description=what)


def _command() -> str:
    return " ".join(["clothrf", *sys.argv[1:]])


def _console() -> Console:
    return Console(stderr=True)


def _say(text: str) -> None:
    Console().print(text, markup=False, highlight=False, soft_wrap=True)


def _warn(text: str) -> None:
    _console().print(f"warning: {text}", style="bold yellow", markup=False, soft_wrap=True)
