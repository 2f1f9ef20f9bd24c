"""The verbs: small pure Protocols that plugins implement.

Inherit one explicitly and a forgotten method is refused when the object is made; or just have the
same methods. What a type cannot say is checked by the suites in `clothrf_core.testing`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np

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
    GraspState,
    Observation,
    RgbdFrame,
    RobotCommand,
)


class Simulator(Protocol):
    """Cloth held by four corners. Same seed and same calls, same bits."""

    @abstractmethod
    def reset(self, rng: np.random.Generator, params: SimulationParams) -> ClothState:
        """Hang a new cloth at the given corners, let it settle, and return its state."""

    @abstractmethod
    def step(self, grasp_targets: Float, hands: Float, dt: float) -> ClothState:
        """Move the corners to (2, 3) `grasp_targets` and (2, 3) `hands` (world) within `dt` s.

        Corners move linearly during the step. Corners farther apart than the cloth reaches give
        ``feasible=False`` and finite numbers, never NaN.
        """

    @abstractmethod
    def mesh(self) -> ClothMesh:
        """Topology of the present cloth; constant between two resets."""


class Camera(Protocol):
    """A source of RGB-D frames. A context manager: nothing is opened before `__enter__`."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    @abstractmethod
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        """The next frame; stamps strictly increase.

        Raises:
            StaleFrame: no new frame within `timeout_s`, or the source has ended.
        """


@runtime_checkable
class RenderedCamera(Camera, Protocol):
    """A camera that draws a `Scene`; `read` draws the scene of the world it was built with."""

    @abstractmethod
    def render(self, scene: Scene, camera: CameraModel) -> Picture:
        """Colour, depth and labels of `scene` seen by `camera`, stamped with the scene's time."""


class FeatureExtractor(Protocol):
    """Picture to numbers; a pure function of the observation."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """F names, one a feature, always the same for one configuration."""

    @abstractmethod
    def extract(self, observation: Observation) -> Features:
        """(F,) features and anchor; ``valid=False`` instead of a crash on an empty picture."""


class Policy(Protocol):
    """Features to action. Fitted on rows, stored as arrays (no pickle)."""

    @property
    @abstractmethod
    def tasks(self) -> tuple[str, ...]:
        """Names of the tasks it was fitted for; empty before `fit`."""

    @abstractmethod
    def fit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        """Learn from all rows anew; returns numbers worth plotting (for example ``leaves``)."""

    @abstractmethod
    def act(self, features: Features, task: str) -> Action:
        """Desired grasp points for `task`.

        Raises:
            FeatureMismatch: the features have other names than those it was fitted on.
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write the fitted policy into an existing empty folder (arrays and JSON)."""

    @abstractmethod
    def load(self, folder: Path) -> Self:
        """A policy that acts bit-identically to the saved one.

        Raises:
            DataError: the folder is corrupt, incomplete or of another kind of policy.
        """


@runtime_checkable
class Refittable(Protocol):
    """A policy that can keep what it has built and learn only its answers anew."""

    @abstractmethod
    def refit(self, view: DatasetView, rng: np.random.Generator) -> Mapping[str, float]:
        """Learn from all rows without building anew; needs an earlier `fit` or `load`."""


class Expert(Protocol):
    """Knows the true hands and says where the grippers should be (the paper's pi*)."""

    @abstractmethod
    def label(self, state: ClothState) -> Action:
        """x* of this state; defined for every legal hand pose."""


class HandMotion(Protocol):
    """How the person moves the two corners they hold."""

    @abstractmethod
    def reset(self, rng: np.random.Generator) -> Float:
        """Start a new motion; (2, 3) float64 start pose of the hands, world."""

    @abstractmethod
    def step(self, dt: float) -> Float:
        """(2, 3) float64 hands `dt` seconds later; speed and distance limits are kept."""

    @property
    @abstractmethod
    def arrivals(self) -> int:
        """Targets reached since `reset`; an episode ends after a number of them."""


class Robot(Protocol):
    """Something that holds two corners and goes where it is told, within its limits."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the arms, then let go of the connection."""

    @abstractmethod
    def state(self) -> GraspState:
        """Where the grippers are now."""

    @abstractmethod
    def send(self, command: RobotCommand) -> RobotCommand:
        """Start moving towards the command's targets; returns the command really sent."""


class Randomizer(Protocol):
    """Varies roll-outs and pictures. Same generator, same result; strength 0 = identity."""

    @abstractmethod
    def draw(self, rng: np.random.Generator, nominal: Randomization) -> Randomization:
        """What one roll-out looks like."""

    @abstractmethod
    def corrupt(
        self, frame: RgbdFrame, params: Randomization, rng: np.random.Generator
    ) -> RgbdFrame:
        """The frame as a real sensor might have read it; a new frame, the input is not changed."""


class World(Protocol):
    """The simulated world that rendered cameras look at and simulated robots act in."""

    @abstractmethod
    def scene(self) -> Scene:
        """What there is to draw now."""

    @abstractmethod
    def camera_model(self) -> CameraModel:
        """The camera to draw it with."""

    @abstractmethod
    def grasp(self) -> GraspState:
        """Where the robot holds the cloth now."""

    @abstractmethod
    def advance(self, command: RobotCommand) -> None:
        """Let one control period pass while the robot follows `command`."""


class JointLimits(Protocol):
    """(J,) float64 arrays; radians and seconds.

    `lower` and `upper` are the controller's; nothing is ever sent outside `soft_lower` and
    `soft_upper`, which lie inside them. `velocity`, `acceleration` and `jerk` bound every motion,
    stops included.
    """

    @property
    @abstractmethod
    def lower(self) -> Float:
        """Hard lower bound, rad."""

    @property
    @abstractmethod
    def upper(self) -> Float:
        """Hard upper bound, rad."""

    @property
    @abstractmethod
    def soft_lower(self) -> Float:
        """Least position ever sent, rad."""

    @property
    @abstractmethod
    def soft_upper(self) -> Float:
        """Greatest position ever sent, rad."""

    @property
    @abstractmethod
    def velocity(self) -> Float:
        """Greatest speed, rad/s."""

    @property
    @abstractmethod
    def acceleration(self) -> Float:
        """Greatest acceleration, rad/s^2, in stops too."""

    @property
    @abstractmethod
    def cruise(self) -> Float:
        """Greatest acceleration while following targets, rad/s^2; at most `acceleration`."""

    @property
    @abstractmethod
    def jerk(self) -> Float:
        """Greatest jerk, rad/s^3, in stops too."""


class JointLimiter(Protocol):
    """Turns joint targets that may jump into a motion within velocity, acceleration and jerk."""

    @abstractmethod
    def tick(self, target: Float) -> tuple[Float, Float, Float]:
        """Next (q, qd, qdd), each (J,), on the way to `target` at rest there.

        `target` is clamped to the soft limits.

        Raises:
            RefusedTarget: wrong length or not finite; the state is unchanged.
        """

    @abstractmethod
    def stop(self) -> tuple[Float, Float, Float]:
        """Next (q, qd, qdd) of the fastest jerk-limited stop; call until all speeds are zero."""

    @property
    @abstractmethod
    def at_rest(self) -> bool:
        """All speeds and accelerations are zero."""


class ArmModel(Protocol):
    """Kinematics of a robot with two grippers: what the stream and the bridge ask about it.

    Joint vectors are (J,) float64 radians in the order of `joint_names`.
    """

    @property
    @abstractmethod
    def joint_names(self) -> tuple[str, ...]:
        """J joint names, in the order of every joint vector."""

    @property
    @abstractmethod
    def limits(self) -> JointLimits:
        """Hard joint limits, speeds, accelerations and jerks of the chosen profile."""

    @property
    @abstractmethod
    def ready(self) -> Float:
        """(J,) a posture to start from."""

    @abstractmethod
    def grasp_points(self, q: Float) -> Float:
        """(2, 3) gripper positions, world; index 0 and 1 as in `ClothState.grasp`."""

    @abstractmethod
    def solve(self, q: Float, targets: Float, dt: float) -> Float:
        """(J,) posture reached from `q` towards (2, 3) `targets` within `dt`, limits kept.

        Raises:
            RefusedTarget: unreachable, jumping or not finite; hold.
        """

    @abstractmethod
    def clearance(self, q: Float) -> tuple[float, str]:
        """Least distance in metres of any pair of bodies that may collide, and its name."""

    @abstractmethod
    def grasp_speeds(self, q: Float, qd: Float) -> Float:
        """(2,) speed of each gripper in m/s."""

    @abstractmethod
    def limiter(self, dt: float, *, q: Float) -> JointLimiter:
        """A fresh motion limiter at rest at `q`, ticking every `dt` seconds."""

    def capsules(self, q: Float) -> Sequence[tuple[Float, Float, float]]:
        """What the arms look like at `q`: (p0, p1, radius), end points (3,) world, metres."""
        return ()

    def fixtures(self) -> Sequence[tuple[Float, Float]]:
        """What of the robot never moves, as boxes between two corners (3,), world, metres."""
        return ()


class BridgeEnd(Protocol):
    """Where the bridge's joint stream ends: a simulated YuMi or ABB's EGM."""

    @abstractmethod
    def __enter__(self) -> Self: ...

    @abstractmethod
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    @abstractmethod
    def measured(self) -> tuple[Float, Float] | None:
        """(q, qd) measured last, or None while no controller is connected and ready to move.

        After a controller's session has restarted, the next call gives None once, so that no
        restart goes unseen: take the old motion back and start anew from the next measurement.
        """

    @abstractmethod
    def put(self, q: Float, qd: Float) -> None:
        """Follow this posture and speed from now on.

        After a restart, postures are ignored until one is close to what was measured. Where one of
        several controllers went, the rest go on: so they can be stopped gently.
        """

    @abstractmethod
    def health(self) -> Mapping[str, float]:
        """Counters worth publishing: cycles, missed cycles, age of the last measurement."""
