"""Small honest components: no physics worth the name, but every promise of the contracts kept.

For tests of plugins that need the rest of a loop around them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from typing_extensions import override

from clothrf_core.camera_model import back_project, project
from clothrf_core.errors import DataError, FeatureMismatch, StaleFrame
from clothrf_core.files import npz_bytes, read_npz
from clothrf_core.interfaces import (
    Expert,
    FeatureExtractor,
    HandMotion,
    Policy,
    Randomizer,
    RenderedCamera,
    Simulator,
    World,
)
from clothrf_core.params import Randomization, SimulationParams
from clothrf_core.scene import Picture, Scene
from clothrf_core.types import (
    Action,
    CameraModel,
    ClothMesh,
    ClothState,
    DatasetView,
    Features,
    Float,
    Observation,
    RgbdFrame,
)


class SheetSimulator(Simulator):
    """A massless sheet: bilinear between its four corners, always at rest."""

    def __init__(self) -> None:
        self._params: SimulationParams | None = None
        self._state: ClothState | None = None

    @override
    def reset(self, rng: np.random.Generator, params: SimulationParams) -> ClothState:
        self._params = params
        self._state = self._at(np.array(params.grasp), np.array(params.hands), 0.0)
        return self._state

    @override
    def step(self, grasp_targets: Float, hands: Float, dt: float) -> ClothState:
        assert self._state is not None
        self._state = self._at(np.array(grasp_targets), np.array(hands), self._state.time_s + dt)
        return self._state

    @override
    def mesh(self) -> ClothMesh:
        assert self._params is not None
        nu, nv = self._params.resolution
        size = self._params.size
        index = np.arange(nu * nv).reshape(nv, nu)
        a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)]
        v, u = np.meshgrid(np.linspace(0, size[1], nv), np.linspace(0, size[0], nu), indexing="ij")
        edges = [
            np.stack([index[:, :-1], index[:, 1:]], -1).reshape(-1, 2),
            np.stack([index[:-1], index[1:]], -1).reshape(-1, 2),
        ]
        return ClothMesh(
            triangles=np.concatenate(faces).astype(np.int32),
            rest=np.stack([u.ravel(), v.ravel()], axis=1),
            corners=np.array([0, nu - 1, nu * (nv - 1), nu * nv - 1], np.int32),
            edges=np.concatenate(edges).astype(np.int32),
        )

    def _at(self, grasp: Float, hands: Float, time_s: float) -> ClothState:
        assert self._params is not None
        nu, nv = self._params.resolution
        u = np.linspace(0.0, 1.0, nu)[None, :, None]
        v = np.linspace(0.0, 1.0, nv)[:, None, None]
        near = hands[0] * (1 - u) + hands[1] * u
        far = grasp[0] * (1 - u) + grasp[1] * u
        vertices = ((1 - v) * near + v * far).reshape(-1, 3)
        reach = np.linalg.norm(grasp - hands, axis=1).max() <= self._params.size[1] * 1.001
        return ClothState(vertices, np.zeros_like(vertices), hands, grasp, bool(reach), time_s)


class SplatCamera(RenderedCamera):
    """Draws the centres of triangles as squares of pixels; coarse, but exact in depth there."""

    def __init__(self, world: World | None = None, *, spread: int = 3) -> None:
        self._world = world
        self._spread = spread
        self._last_ns = -1

    @override
    def __enter__(self) -> Self:
        self._last_ns = -1
        return self

    @override
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        return None

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        if self._world is None:
            raise StaleFrame("SplatCamera: expected a world to look at, found none")
        frame = self.render(self._world.scene(), self._world.camera_model()).frame
        if frame.stamp_ns <= self._last_ns:
            raise StaleFrame(f"SplatCamera: the world still shows {frame.stamp_ns} ns")
        self._last_ns = frame.stamp_ns
        return frame

    @override
    def render(self, scene: Scene, camera: CameraModel) -> Picture:
        h, w = camera.height, camera.width
        depth = np.full((h, w), np.nan, np.float32)
        labels = np.zeros((h, w), np.uint8)
        rgb = np.zeros((h, w, 3), np.uint8)
        meshes = scene.meshes
        if meshes:
            centres = [np.asarray(m.vertices)[m.triangles].mean(axis=1) for m in meshes]
            owner = np.repeat(np.arange(len(meshes)), [len(c) for c in centres])
            pixels, z = project(camera, np.concatenate(centres))
            seen = np.isfinite(pixels).all(axis=1) & (z > camera.near) & (z < camera.far)
            shift = np.arange(-self._spread, self._spread + 1)
            du, dv = (d.ravel() for d in np.meshgrid(shift, shift))
            far_first = np.flatnonzero(seen)[np.argsort(-z[seen], kind="stable")]
            corner = np.rint(pixels[far_first]).astype(int)
            u, v = (corner[:, :1] + du).ravel(), (corner[:, 1:] + dv).ravel()
            which = np.repeat(far_first, len(du))
            inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
            u, v, which = u[inside], v[inside], which[inside]
            measurable = np.array([m.measurable for m in meshes])
            colours = np.array([[round(255 * c) for c in m.colour] for m in meshes], np.uint8)
            kinds = np.array([int(m.label) for m in meshes], np.uint8)
            depth[v, u] = np.where(measurable[owner[which]], z[which], np.nan)
            labels[v, u] = kinds[owner[which]]
            rgb[v, u] = colours[owner[which]]
        return Picture(RgbdFrame(scene.stamp_ns, rgb, depth, camera), labels)


class BlockFeatures(FeatureExtractor):
    """Mean height of the measured points in 4 x 4 blocks of the picture, and their anchor."""

    def __init__(self, *, depth_max: float = 2.0) -> None:
        self._depth_max = depth_max
        cells = [(r, c, x) for r in range(4) for c in range(4) for x in "xyz"]
        self._names = tuple(f"block_r{r}_c{c}_{x}" for r, c, x in cells)

    @property
    @override
    def names(self) -> tuple[str, ...]:
        return self._names

    @override
    def extract(self, observation: Observation) -> Features:
        frame = observation.frame
        rows, columns = np.nonzero(frame.depth < self._depth_max)
        if rows.size < 16:
            empty = np.zeros(len(self._names), np.float32)
            return Features(empty, self._names, np.zeros(3), valid=False)
        pixels = np.stack([columns, rows], axis=1).astype(float)
        points = back_project(frame.camera, pixels, frame.depth[rows, columns].astype(float))
        anchor = points.mean(axis=0)
        values = np.zeros((16, 3), np.float32)
        block = (rows * 4 // frame.camera.height) * 4 + columns * 4 // frame.camera.width
        for b in np.unique(block):
            values[b] = (points[block == b] - anchor).mean(axis=0)
        return Features(values.ravel(), self._names, anchor)


@dataclass(frozen=True)
class OffsetExpert(Expert):
    """Grippers at a fixed offset (3,) from the hands, m."""

    offset: tuple[float, float, float] = (-0.3, 0.0, 0.0)

    @override
    def label(self, state: ClothState) -> Action:
        return Action(np.asarray(state.hands) + np.array(self.offset))


class CirclingHands(HandMotion):
    """Both hands on one circle about their rest pose, from a random angle."""

    def __init__(self, rest: Float, *, radius: float = 0.05, speed: float = 0.08) -> None:
        self._rest = np.asarray(rest, float)
        self._radius = radius
        self._rate = speed / radius
        self._angle = 0.0
        self._start = 0.0

    @override
    def reset(self, rng: np.random.Generator) -> Float:
        self._angle = self._start = float(rng.uniform(0.0, 2.0 * np.pi))
        return self._pose()

    @override
    def step(self, dt: float) -> Float:
        self._angle += self._rate * dt
        return self._pose()

    @property
    @override
    def arrivals(self) -> int:
        return int((self._angle - self._start) / (np.pi / 4))

    def _pose(self) -> Float:
        turn = np.array([np.cos(self._angle), np.sin(self._angle), 0.0])
        result: Float = self._rest + self._radius * turn
        return result


class NoRandomizer(Randomizer):
    """Nothing varies."""

    @override
    def draw(self, rng: np.random.Generator, nominal: Randomization) -> Randomization:
        return nominal

    @override
    def corrupt(
        self, frame: RgbdFrame, params: Randomization, rng: np.random.Generator
    ) -> RgbdFrame:
        return frame


class LeastSquaresPolicy(Policy):
    """Ridge regression of anchor-relative targets, in numpy."""

    def __init__(self, *, penalty: float = 1e-3) -> None:
        self._penalty = penalty
        self._tasks: tuple[str, ...] = ()
        self._names: tuple[str, ...] = ()
        self._weights = np.zeros((0, 0))

    @property
    @override
    def tasks(self) -> tuple[str, ...]:
        return self._tasks

    @override
    def fit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        x = np.c_[view.features, np.ones(len(view))].astype(float)
        y = (view.labels - view.anchors[:, None, None, :]).reshape(len(view), -1)
        gram = x.T @ x + self._penalty * len(x) * np.eye(x.shape[1])
        self._weights = np.linalg.solve(gram, x.T @ y)
        self._tasks, self._names = view.tasks, view.names
        return {"parameters": float(self._weights.size)}

    @override
    def act(self, features: Features, task: str) -> Action:
        if features.names != self._names:
            raise FeatureMismatch(
                f"expected {len(self._names)} features {self._names[:2]}..., "
                f"got {len(features.names)} {features.names[:2]}..."
            )
        y = np.r_[features.values.astype(float), 1.0] @ self._weights
        t = self._tasks.index(task)
        return Action(y.reshape(len(self._tasks), 2, 3)[t] + features.anchor)

    @override
    def save(self, folder: Path) -> None:
        (folder / "weights.npz").write_bytes(npz_bytes({"weights": self._weights}))
        meta = {"tasks": self._tasks, "names": self._names}
        (folder / "policy.json").write_text(json.dumps(meta))

    @override
    def load(self, folder: Path) -> Self:
        weights = read_npz(folder / "weights.npz").get("weights")
        try:
            meta = json.loads((folder / "policy.json").read_text())
            tasks, names = tuple(meta["tasks"]), tuple(meta["names"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{folder}: expected a least-squares policy ({error})") from error
        if weights is None or weights.shape != (len(names) + 1, 6 * len(tasks)):
            raise DataError(f"{folder}: the weights do not fit the names; the files are mixed up")
        loaded = type(self)(penalty=self._penalty)
        loaded._tasks, loaded._names, loaded._weights = tasks, names, weights
        return loaded
