from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from clothrf_calibration import rigid
from clothrf_calibration.errors import CalibrationError
from clothrf_calibration.posefile import csv_line, match, read_poses
from clothrf_calibration.session import POSES_HEADER
from scipy.spatial.transform import Rotation

from clothrf_core.types import Float


def made(count: int = 5) -> Float:
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = rigid.exp(rng.normal(size=(count, 3)))
    T[:, :3, 3] = rng.uniform(-0.5, 0.5, (count, 3))
    return T


def test_poses_written_as_quaternions_read_back(tmp_path: Path) -> None:
    T = made()
    path = tmp_path / "poses.csv"
    path.write_text(POSES_HEADER + "".join(csv_line(f"{n:04d}", t) for n, t in enumerate(T)))

    found = read_poses(path)

    assert found.names == ("0000", "0001", "0002", "0003", "0004")
    assert np.allclose(found.T_base_gripper, T, atol=1e-8)


@pytest.mark.parametrize(
    ("header", "convert"),
    [
        ("x,y,z,rx,ry,rz", lambda R: R.as_rotvec()),
        ("x,y,z,roll,pitch,yaw", lambda R: R.as_euler("xyz")),
        ("x,y,z,qx,qy,qz,qw", lambda R: R.as_quat()),
    ],
)
def test_other_forms_of_rotation_are_read(tmp_path: Path, header: str, convert: object) -> None:
    T = made()
    assert callable(convert)
    lines = [
        ",".join(f"{n:.12g}" for n in (*t[:3, 3], *convert(Rotation.from_matrix(t[:3, :3]))))
        for t in T
    ]
    path = tmp_path / "p.csv"
    path.write_text(header + "\n" + "\n".join(lines) + "\n")

    assert np.allclose(read_poses(path).T_base_gripper, T, atol=1e-9)


def test_poses_in_millimetres_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("x,y,z,rx,ry,rz\n400,100,300,0,0,1\n410,90,310,0,1,0\n")

    with pytest.raises(CalibrationError) as caught:
        read_poses(path)

    assert str(caught.value) == (
        f"{path}: expected metres, found positions of 516 (median); they look like millimetres: "
        "divide them by 1000"
    )


def test_poses_in_degrees_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("x,y,z,roll,pitch,yaw\n0.4,0.1,0.3,0,0,90\n0.4,0.1,0.3,180,0,0\n")

    with pytest.raises(CalibrationError) as caught:
        read_poses(path)

    assert str(caught.value) == (
        f"{path}: expected radians, found angles up to 180; they look like degrees: multiply them "
        "by pi / 180"
    )


def test_matrices_in_millimetres_are_refused(tmp_path: Path) -> None:
    T = made()
    T[:, :3, 3] *= 1000
    path = tmp_path / "p.json"
    path.write_text(json.dumps(T.tolist()))

    with pytest.raises(CalibrationError, match="they look like millimetres"):
        read_poses(path)


def test_slightly_skewed_rotations_are_put_right_and_said(tmp_path: Path) -> None:
    T = made()
    T[:, 0, 0] += 1e-4
    path = tmp_path / "p.json"
    path.write_text(json.dumps(T.tolist()))

    found = read_poses(path)

    R = found.T_base_gripper[:, :3, :3]
    assert np.allclose(R @ np.swapaxes(R, 1, 2), np.eye(3), atol=1e-12)
    assert "have been re-orthonormalised" in found.notes[0]


def test_matrices_that_are_no_rotations_are_refused(tmp_path: Path) -> None:
    T = made()
    T[2, :3, :3] *= 1.5
    path = tmp_path / "p.json"
    path.write_text(json.dumps(T.tolist()))

    with pytest.raises(CalibrationError, match="expected rotation matrices"):
        read_poses(path)


def test_a_picture_without_a_pose_is_named(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(POSES_HEADER + csv_line("0001", np.eye(4)))

    with pytest.raises(CalibrationError) as caught:
        match(read_poses(path), ["0001", "0002"])

    assert str(caught.value) == (
        "expected a pose for every picture, found none for 0002 among 1 poses; names in the file "
        "must be those of the pictures"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "expected the columns x,y,z and qx,qy,qz,qw"),
        ("x,y,z,rx,ry,rz\n", "expected rows of poses under a header, found none"),
        ("x,y,z,rx,ry,rz\n1,2,three,0,0,0\n", "expected numbers in every row"),
        ("x,y,z,qx,qy,qz,qw\n0,0,0,1,1,0,0\n", "expected unit quaternions"),
    ],
)
def test_malformed_tables_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.csv"
    path.write_text(text)

    with pytest.raises(CalibrationError, match=message):
        read_poses(path)
