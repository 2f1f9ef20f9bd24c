"""Robot poses from a file: positions in metres, rotations in radians, checked for plausibility.

CSV with a header: ``name`` (optional), ``x,y,z`` and one of ``qx,qy,qz,qw`` (quaternion),
``rx,ry,rz`` (rotation vector) or ``roll,pitch,yaw`` (fixed axes x, y, z); or none of these, where
the robot tells positions only. JSON: a list of 4 x 4
matrices, an object name -> matrix, or a list of pairs [T_base_gripper, T_camera_board].
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothrf_calibration import rigid
from clothrf_calibration.errors import CalibrationError
from clothrf_core.files import read_json
from clothrf_core.geometry import nearest_rotation
from clothrf_core.types import Float

REACH = 5.0
QUATERNION, VECTOR, ANGLES = ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz"), ("roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Named robot poses.

    Attributes:
        names: picture each belongs to; empty if the file has no names.
        T_base_gripper: (V, 4, 4).
        T_camera_board: (V, 4, 4) where the file holds pairs, else None.
        notes: what was put right, one line each.
        positions_only: the rotations are unknown and stand as identities.
    """

    names: tuple[str, ...]
    T_base_gripper: Float
    T_camera_board: Float | None = None
    notes: tuple[str, ...] = ()
    positions_only: bool = False


def read_poses(path: Path) -> Poses:
    """The poses in `path`.

    Raises:
        CalibrationError: missing, malformed, in millimetres or in degrees.
    """
    if not path.exists():
        raise CalibrationError(f"{path}: expected a file of robot poses, found none")
    return _json(path) if path.suffix == ".json" else _csv(path)


def match(poses: Poses, names: Sequence[str]) -> Float:
    """(V, 4, 4) poses in the order of the pictures `names`.

    Raises:
        CalibrationError: the numbers differ, or a picture has no pose.
    """
    if not poses.names:
        if len(names) != len(poses.T_base_gripper):
            raise CalibrationError(
                f"expected a pose for every picture, found {len(names)} pictures and "
                f"{len(poses.T_base_gripper)} poses; give every pose the name of its picture"
            )
        return poses.T_base_gripper
    rows = {name: n for n, name in enumerate(poses.names)}
    missing = [name for name in names if name not in rows]
    if missing:
        raise CalibrationError(
            f"expected a pose for every picture, found none for {missing[0]}"
            + (f" and {len(missing) - 1} others" if len(missing) > 1 else "")
            + f" among {len(rows)} poses; names in the file must be those of the pictures"
        )
    return poses.T_base_gripper[[rows[name] for name in names]]


def csv_line(name: str, T: Float) -> str:
    """One row of a pose file, quaternion last."""
    q = quaternion(T[:3, :3])
    numbers = [*T[:3, 3], *q]
    return ",".join([name, *(f"{float(n):.9g}" for n in numbers)]) + "\n"


def quaternion(R: Float) -> Float:
    """(4,) x, y, z, w of a rotation."""
    w = rigid.log(R)
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.append(np.sin(angle / 2) * w / angle, np.cos(angle / 2))


def _csv(path: Path) -> Poses:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file, skipinitialspace=True))
    if not rows:
        raise CalibrationError(f"{path}: expected rows of poses under a header, found none")
    header = [c for c in rows[0] if c is not None]
    form = next((f for f in (QUATERNION, VECTOR, ANGLES) if set(f) <= set(header)), None)
    if set(header) in ({"name", "x", "y", "z"}, {"x", "y", "z"}):
        return _positions(path, rows)
    if form is None or not {"x", "y", "z"} <= set(header):
        raise CalibrationError(
            f"{path}: expected the columns x,y,z and qx,qy,qz,qw or rx,ry,rz or roll,pitch,yaw, "
            f"found {','.join(header)}"
        )
    try:
        t = np.array([[float(r[c]) for c in ("x", "y", "z")] for r in rows])
        turn = np.array([[float(r[c]) for c in form] for r in rows])
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: expected numbers in every row ({error})") from error
    _refuse_units(path, t, turn if form is not QUATERNION else None)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, 3] = t
    notes: tuple[str, ...] = ()
    if form is QUATERNION:
        norm = np.linalg.norm(turn, axis=1)
        if (np.abs(norm - 1.0) > 0.02).any():
            raise CalibrationError(
                f"{path}: expected unit quaternions, found one of length "
                f"{norm[np.argmax(np.abs(norm - 1))]:.3f}; check the columns' order"
            )
        T[:, :3, :3] = _of_quaternion(turn / norm[:, None])
    elif form is VECTOR:
        T[:, :3, :3] = rigid.exp(turn)
    else:
        T[:, :3, :3] = _of_angles(turn)
    return Poses(tuple(r["name"] for r in rows) if "name" in header else (), T, None, notes)


def _positions(path: Path, rows: list[dict[str, str]]) -> Poses:
    try:
        t = np.array([[float(r[c]) for c in ("x", "y", "z")] for r in rows])
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: expected numbers in every row ({error})") from error
    _refuse_units(path, t, None)
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, 3] = t
    names = tuple(r["name"] for r in rows) if "name" in rows[0] else ()
    return Poses(names, T, positions_only=True)


def _json(path: Path) -> Poses:
    value = read_json(path)
    names: tuple[str, ...] = ()
    if isinstance(value, dict):
        names, value = tuple(value), list(value.values())
    try:
        T = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: expected 4 x 4 matrices ({error})") from error
    if T.ndim == 4 and T.shape[1:] == (2, 4, 4):
        _refuse_units(path, T[:, 0, :3, 3], None)
        robot, note = _rotations(path, T[:, 0])
        board, _ = _rotations(path, T[:, 1])
        return Poses(names, robot, board, note)
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise CalibrationError(
            f"{path}: expected a list of 4 x 4 matrices or of pairs of them, found an array of "
            f"shape {T.shape}"
        )
    _refuse_units(path, T[:, :3, 3], None)
    fixed, note = _rotations(path, T)
    return Poses(names, fixed, None, note)


def _rotations(path: Path, T: Float) -> tuple[Float, tuple[str, ...]]:
    """Transforms with exact rotations, and what was put right."""
    off = float(np.abs(T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2) - np.eye(3)).max())
    if off > 0.02 or (np.linalg.det(T[:, :3, :3]) < 0).any():
        raise CalibrationError(
            f"{path}: expected rotation matrices, found one that is {off:.2g} off; is the matrix "
            "transposed, scaled or left-handed?"
        )
    out = np.array(T)
    for n in range(len(T)):
        out[n, :3, :3] = nearest_rotation(T[n, :3, :3])
    note = f"{path.name}: rotations were {off:.1e} off and have been re-orthonormalised"
    return out, (note,) if off > 1e-6 else ()


def _refuse_units(path: Path, t: Float, turn: Float | None) -> None:
    far = float(np.median(np.linalg.norm(t, axis=1)))
    if far > REACH:
        raise CalibrationError(
            f"{path}: expected metres, found positions of {far:.0f} (median); they look like "
            "millimetres: divide them by 1000"
        )
    if turn is not None and float(np.abs(turn).max()) > 2.05 * np.pi:
        raise CalibrationError(
            f"{path}: expected radians, found angles up to {np.abs(turn).max():.0f}; they look "
            "like degrees: multiply them by pi / 180"
        )


def _of_quaternion(q: Float) -> Float:
    x, y, z, w = q.T
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(R), 2, 0)


def _of_angles(rpy: Float) -> Float:
    zero = np.zeros(len(rpy))
    roll = rigid.exp(np.stack([rpy[:, 0], zero, zero], 1))
    pitch = rigid.exp(np.stack([zero, rpy[:, 1], zero], 1))
    yaw = rigid.exp(np.stack([zero, zero, rpy[:, 2]], 1))
    return np.asarray(yaw @ pitch @ roll)
