"""Writes `yumi.urdf` from the numbers in `irb14000.py`: ``python -m clothrf_yumi.urdf FILE``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from clothrf_core.types import Float
from clothrf_yumi.irb14000 import (
    AXES,
    BASE_ANGLES_DEG,
    BASE_MASS,
    BASE_XYZ,
    BODY,
    FINGER_TCP_M,
    FINGERS,
    FLANGE_M,
    GRIPPER,
    GRIPPER_BODY,
    SIDES,
    Axis,
    Capsule,
    Mass,
    joint_name,
)


def urdf() -> str:
    """The robot as URDF, the same bytes each time; capsules as a cylinder and two spheres."""
    parts = [
        '<?xml version="1.0"?>',
        "<!-- ABB YuMi IRB 14000: nominal kinematics, estimated masses, capsules for links.",
        "     World = the robot's base frame, x forward, z up. Written by urdf.py. -->",
        '<robot name="yumi">',
        '  <link name="base">',
        *_inertial(BASE_MASS),
        *(line for box in BODY for line in _box(box.low, box.high)),
        "  </link>",
    ]
    for side in SIDES:
        parts += _arm(side)
    return "\n".join([*parts, "</robot>", ""])


def _arm(side: str) -> list[str]:
    s = side[0]
    sign = 1.0 if side == "left" else -1.0
    xyz = np.array(BASE_XYZ) * [1.0, sign, 1.0]
    ry, rx, rz = np.radians(BASE_ANGLES_DEG)
    base = rotation("y", ry) @ rotation("x", sign * rx) @ rotation("z", sign * rz)
    lines = [
        f'  <link name="yumi_base_{s}"/>',
        *_joint(f"yumi_base_joint_{s}", "base", f"yumi_base_{s}", xyz, base),
    ]
    parent = f"yumi_base_{s}"
    for axis in AXES:
        child = f"yumi_link_{axis.number}_{s}"
        # The joint turns last, so d and the offset stand before it: they share its axis.
        twist = rotation("x", axis.alpha)
        offset = twist @ np.array([axis.a, 0.0, axis.d])
        lines += [
            f'  <link name="{child}">',
            *_inertial(axis.mass),
            *_capsule(axis.link),
            "  </link>",
            *_joint(
                joint_name(axis.number, side),
                parent,
                child,
                offset,
                twist @ rotation("z", axis.offset),
                axis=axis,
            ),
        ]
        parent = child
    flange, tcp = np.array([0.0, 0.0, FLANGE_M]), np.array([0.0, 0.0, FINGER_TCP_M])
    return [
        *lines,
        f'  <link name="yumi_tool0_{s}">',
        *_inertial(GRIPPER),
        *_capsule(GRIPPER_BODY),
        *_capsule(FINGERS),
        "  </link>",
        *_joint(f"yumi_tool0_joint_{s}", parent, f"yumi_tool0_{s}", flange, np.eye(3)),
        f'  <link name="yumi_tcp_{s}"/>',
        *_joint(f"yumi_tcp_joint_{s}", f"yumi_tool0_{s}", f"yumi_tcp_{s}", tcp, np.eye(3)),
    ]


def rotation(axis: str, angle: float) -> Float:
    """(3, 3) rotation by `angle` radians about x, y or z; exact at multiples of a right angle."""
    turns = angle / (np.pi / 2.0)
    c, s = np.cos(angle), np.sin(angle)
    if turns == round(turns):
        c, s = round(c), round(s)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


def roll_pitch_yaw(R: Float) -> Float:
    """(3,) radians with R = Rz(yaw) Ry(pitch) Rx(roll); yaw = 0 where pitch is a right angle."""
    if abs(R[2, 0]) > 1.0 - 1e-12:
        sign = -np.sign(R[2, 0])
        return np.array([np.arctan2(sign * R[0, 1], sign * R[0, 2]), sign * np.pi / 2.0, 0.0])
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def _joint(
    name: str, parent: str, child: str, xyz: Float, R: Float, *, axis: Axis | None = None
) -> list[str]:
    lines = [
        f'  <joint name="{name}" type="{"fixed" if axis is None else "revolute"}">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    <origin xyz="{_numbers(xyz)}" rpy="{_numbers(roll_pitch_yaw(R))}"/>',
    ]
    if axis is not None:
        low, high, speed = np.radians([axis.lower, axis.upper, axis.speed])
        lines += [
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="{low!s}" upper="{high!s}" velocity="{speed!s}" effort="50"/>',
        ]
    return [*lines, "  </joint>"]


def _inertial(mass: Mass) -> list[str]:
    ixx, iyy, izz = mass.moments
    return [
        "    <inertial>",
        f'      <origin xyz="{_numbers(mass.centre)}"/>',
        f'      <mass value="{mass.mass}"/>',
        f'      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>',
        "    </inertial>",
    ]


def _box(low: tuple[float, ...], high: tuple[float, ...]) -> list[str]:
    centre, size = (np.array(high) + low) / 2.0, np.array(high) - low
    return _shapes(centre, np.zeros(3), f'<box size="{_numbers(size)}"/>')


def _capsule(capsule: Capsule) -> list[str]:
    start, end = np.array(capsule.start), np.array(capsule.end)
    length = float(np.linalg.norm(end - start))
    sphere = f'<sphere radius="{capsule.radius}"/>'
    rod = f'<cylinder radius="{capsule.radius}" length="{length:.6f}"/>'
    x, y, z = (end - start) / length
    tilt = np.array([0.0, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)])
    return [
        *_shapes(start, np.zeros(3), sphere),
        *_shapes(end, np.zeros(3), sphere),
        *_shapes((start + end) / 2.0, tilt, rod),
    ]


def _shapes(xyz: Float, rpy: Float, shape: str) -> list[str]:
    xyz, rpy = np.round(xyz, 6), np.round(rpy, 6)
    geometry = [
        f'      <origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>',
        f"      <geometry>{shape}</geometry>",
    ]
    return [
        line
        for kind in ("visual", "collision")
        for line in (f"    <{kind}>", *geometry, f"    </{kind}>")
    ]


def _numbers(values: Float | tuple[float, ...]) -> str:
    return " ".join(f"{float(value) + 0.0!r}" for value in values)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(urdf(), encoding="utf-8")
