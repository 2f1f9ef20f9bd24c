"""The nouns: what flows between the parts of clothrf.

Frozen, slotted dataclasses of read-only numpy arrays, checked once where they are made.

Conventions (the same everywhere):

* World frame = the robot's base frame: x forward, z up, right-handed; metres, radians, seconds.
* `T_ab` maps coordinates in b to coordinates in a: ``x_a = T_ab @ x_b``.
* Camera frame = OpenCV's: x right, y down, z along the optical axis. Pixel (0, 0) is the *centre*
  of the top-left pixel.
* Corners: ``hands[i]`` and ``grasp[i]`` are the two ends of side edge i of the cloth; the person
  holds ``hands`` (the paper's v2, v3), the robot ``grasp`` (v0, v1).

Alphabet of shapes: H, W image; G grasp points (2); V vertices; F features; T tasks; N samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothrf_core.arrays import checked
from clothrf_core.errors import ShapeError

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


def _set(instance: Any, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(instance, name, value)


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """A pinhole camera with OpenCV distortion, placed in the world; what calibration writes.

    Attributes:
        width: image width W, pixels.
        height: image height H, pixels.
        K: (3, 3) float64 intrinsic matrix; pixel (0, 0) is the centre of the top-left pixel.
        T_world_camera: (4, 4) float64 pose, camera axes as OpenCV's.
        near: closest depth rendered, metres along the optical axis.
        far: farthest depth rendered, metres along the optical axis.
        distortion: (0,), (4,), (5,) or (8,) float64 OpenCV coefficients; empty = none.
        provenance: one line saying where the numbers come from.
    """

    width: int
    height: int
    K: Float
    T_world_camera: Float
    near: float = 0.05
    far: float = 3.0
    distortion: Float = field(default_factory=lambda: np.zeros(0))
    provenance: str = ""

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or not 0.0 < self.near < self.far:
            raise ShapeError(
                "CameraModel: expected width, height >= 1 and 0 < near < far, got "
                f"{self.width} x {self.height}, near {self.near}, far {self.far}"
            )
        _set(
            self,
            K=checked("CameraModel.K", self.K, (3, 3), np.float64, finite=True),
            T_world_camera=checked(
                "CameraModel.T_world_camera", self.T_world_camera, (4, 4), np.float64, finite=True
            ),
            distortion=checked(
                "CameraModel.distortion", self.distortion, (None,), np.float64, finite=True
            ),
        )
        if self.distortion.size not in (0, 4, 5, 8):
            raise ShapeError(
                "CameraModel.distortion: expected 0, 4, 5 or 8 coefficients, got "
                f"{self.distortion.size}"
            )
        R = self.T_world_camera[:3, :3]
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
            raise ShapeError(
                "CameraModel.T_world_camera: expected a rotation matrix, got one that is "
                f"{np.abs(R @ R.T - np.eye(3)).max():.1e} off; re-orthonormalise it"
            )


@dataclass(frozen=True, slots=True, eq=False)
class RgbdFrame:
    """One colour picture and one depth picture of the same instant and viewpoint.

    Attributes:
        stamp_ns: time of exposure, nanoseconds of a monotonic clock.
        rgb: (H, W, 3) uint8.
        depth: (H, W) float32, metres along the optical axis; NaN where nothing was measured.
        camera: the camera that took it.
    """

    stamp_ns: int
    rgb: NDArray[np.uint8]
    depth: Float32
    camera: CameraModel

    def __post_init__(self) -> None:
        h, w = self.camera.height, self.camera.width
        _set(
            self,
            rgb=checked("RgbdFrame.rgb", self.rgb, (h, w, 3), np.uint8),
            depth=checked("RgbdFrame.depth", self.depth, (h, w), np.float32),
        )


@dataclass(frozen=True, slots=True, eq=False)
class GraspState:
    """Where the robot holds the cloth, measured.

    Attributes:
        positions: (G, 3) float64, metres, world.
        stamp_ns: when it was measured.
    """

    positions: Float
    stamp_ns: int

    def __post_init__(self) -> None:
        _set(
            self,
            positions=checked("GraspState.positions", self.positions, (None, 3), np.float64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """All that a policy may see: the picture and the grasp; no cloth, no hands."""

    frame: RgbdFrame
    grasp: GraspState


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """What a picture says, as numbers.

    Attributes:
        values: (F,) float32.
        names: F names, one a value; a policy refuses features of other names.
        anchor: (3,) float64 world metres: the back-projected centre of the foreground, which
            alignment removes from the picture and targets are relative to.
        valid: False when there was no usable foreground; values and anchor are then zero.
    """

    values: Float32
    names: tuple[str, ...]
    anchor: Float
    valid: bool = True

    def __post_init__(self) -> None:
        _set(
            self,
            values=checked("Features.values", self.values, (len(self.names),), np.float32),
            anchor=checked("Features.anchor", self.anchor, (3,), np.float64, finite=True),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Action:
    """Desired grasp points, the paper's x*.

    Attributes:
        targets: (G, 3) float64, metres, world.
        confidence: in [0, 1]; `limits` slows down when it is low and holds when it is lower.
    """

    targets: Float
    confidence: float = 1.0

    def __post_init__(self) -> None:
        _set(
            self,
            targets=checked("Action.targets", self.targets, (None, 3), np.float64),
        )

    @staticmethod
    def hold(grasp: GraspState) -> Action:
        """Stay where the robot is; the answer to a picture that says nothing."""
        return Action(targets=np.array(grasp.positions), confidence=0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ClothState:
    """The truth of a simulator: for experts and evaluation only, never for a policy.

    Attributes:
        vertices: (V, 3) float64, metres, world.
        velocities: (V, 3) float64, metres a second.
        hands: (2, 3) float64, where the person holds the cloth.
        grasp: (2, 3) float64, where the robot holds it; ``grasp[i]`` faces ``hands[i]``.
        feasible: False when the corners are farther apart than the cloth reaches.
        time_s: simulated time since `reset`.
    """

    vertices: Float
    velocities: Float
    hands: Float
    grasp: Float
    feasible: bool = True
    time_s: float = 0.0

    def __post_init__(self) -> None:
        _set(
            self,
            vertices=checked("ClothState.vertices", self.vertices, (None, 3), np.float64),
            velocities=checked(
                "ClothState.velocities", self.velocities, self.vertices.shape, np.float64
            ),
            hands=checked("ClothState.hands", self.hands, (2, 3), np.float64),
            grasp=checked("ClothState.grasp", self.grasp, (2, 3), np.float64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ClothMesh:
    """Topology of the simulated cloth, fixed between two resets.

    Attributes:
        triangles: (M, 3) int32 vertex indices.
        rest: (V, 2) float64 metres: where each vertex lies on the flat cloth, u across (between
            the two hands), v along (from hand to grasp).
        corners: (4,) int32: vertices of hand 0, hand 1, grasp 0, grasp 1.
        edges: (E, 2) int32: the edges whose strain is reported.
    """

    triangles: NDArray[np.int32]
    rest: Float
    corners: NDArray[np.int32]
    edges: NDArray[np.int32]

    def __post_init__(self) -> None:
        _set(
            self,
            triangles=checked("ClothMesh.triangles", self.triangles, (None, 3), np.int32),
            rest=checked("ClothMesh.rest", self.rest, (None, 2), np.float64),
            corners=checked("ClothMesh.corners", self.corners, (4,), np.int32),
            edges=checked("ClothMesh.edges", self.edges, (None, 2), np.int32),
        )


@dataclass(frozen=True, slots=True, eq=False)
class RobotCommand:
    """Limited grasp targets on their way to a robot; only `limits.py` makes one.

    Attributes:
        sequence: counts up by one for each command of a session, from 0.
        stamp_ns: stamp of the frame that this command answers.
        valid_for_s: after this long without a newer command the robot must stop.
        targets: (G, 3) float64, metres, world.
        held: why the command holds position instead of following the policy; empty if it follows.
    """

    sequence: int
    stamp_ns: int
    valid_for_s: float
    targets: Float
    held: str = ""

    def __post_init__(self) -> None:
        _set(
            self,
            targets=checked("RobotCommand.targets", self.targets, (None, 3), np.float64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class DatasetView:
    """Rows to learn from; features, what every expert says, and which roll-out a row is from.

    Attributes:
        features: (N, F) float32.
        names: F feature names.
        anchors: (N, 3) float64, world.
        labels: (N, T, G, 3) float64 desired grasp points of every task, world.
        tasks: T task names, in the order of `labels`.
        groups: (N,) int64 roll-out of each row; never split a group between train and test.
        grasps: (N, G, 3) float64 where the robot held the cloth, world.
    """

    features: Float32
    names: tuple[str, ...]
    anchors: Float
    labels: Float
    tasks: tuple[str, ...]
    groups: NDArray[np.int64]
    grasps: Float

    def __post_init__(self) -> None:
        n = len(self.features)
        _set(
            self,
            features=checked(
                "DatasetView.features", self.features, (None, len(self.names)), np.float32
            ),
            anchors=checked("DatasetView.anchors", self.anchors, (n, 3), np.float64),
            labels=checked(
                "DatasetView.labels", self.labels, (n, len(self.tasks), None, 3), np.float64
            ),
            groups=checked("DatasetView.groups", self.groups, (n,), np.int64),
            grasps=checked("DatasetView.grasps", self.grasps, (n, None, 3), np.float64),
        )

    def __len__(self) -> int:
        return len(self.features)

    def rows(self, index: Any) -> DatasetView:
        """The same view of some rows only (any numpy index along N)."""
        return DatasetView(
            features=self.features[index],
            names=self.names,
            anchors=self.anchors[index],
            labels=self.labels[index],
            tasks=self.tasks,
            groups=self.groups[index],
            grasps=self.grasps[index],
        )

    def feature_row(self, index: int) -> Features:
        """Row `index` as the `Features` that the policy saw."""
        return Features(
            values=self.features[index], names=self.names, anchor=self.anchors[index], valid=True
        )


def frozen_mapping(values: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
    """A read-only copy of a mapping, for fields of frozen nouns."""
    return MappingProxyType(dict(values or {}))
