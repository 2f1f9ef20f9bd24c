"""ROS 2 message definitions as text, for recordings that explain themselves (MCAP ``ros2msg``)."""

from __future__ import annotations

from collections.abc import Mapping

from clothrf_zenoh.keys import DIAGNOSTIC_ARRAY, JOINT_STATE, JOINT_TRAJECTORY, POSE_ARRAY

_RULE = "=" * 80

_PARTS: Mapping[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start\n"
    ),
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\n"
        "diagnostic_msgs/KeyValue[] values\n"
    ),
}


def _definition(body: str, parts: tuple[str, ...]) -> str:
    return body + "".join(f"{_RULE}\nMSG: {part}\n{_PARTS[part]}" for part in parts)


_HEADER = ("std_msgs/Header", "builtin_interfaces/Time")

SCHEMAS: Mapping[str, str] = {
    JOINT_TRAJECTORY.name: _definition(
        "std_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint[] points\n",
        (*_HEADER, "trajectory_msgs/JointTrajectoryPoint", "builtin_interfaces/Duration"),
    ),
    POSE_ARRAY.name: _definition(
        "std_msgs/Header header\ngeometry_msgs/Pose[] poses\n",
        (*_HEADER, "geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"),
    ),
    JOINT_STATE.name: _definition(
        "std_msgs/Header header\nstring[] name\n"
        "float64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        _HEADER,
    ),
    DIAGNOSTIC_ARRAY.name: _definition(
        "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
        (*_HEADER, "diagnostic_msgs/DiagnosticStatus", "diagnostic_msgs/KeyValue"),
    ),
}
