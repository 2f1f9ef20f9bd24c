"""A simulator and a renderer, seen through the same `Camera` and `Robot` as the real ones.

The simulated world owns everything that a policy must not see: the cloth, the hands, the draw of
the randomiser. One `advance` is one control period: the hands move, the robot follows its command.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, SeedSequence
from typing_extensions import override

from clothrf_core.interfaces import (
    Expert,
    HandMotion,
    Randomizer,
    RenderedCamera,
    Robot,
    Simulator,
    World,
)
from clothrf_core.opening import CameraAround, NothingToOpen
from clothrf_core.params import Randomization, SimulationParams
from clothrf_core.rig import Rig
from clothrf_core.scene import Label, Picture, Scene, SceneMesh, along, box, capsule, cloth_mesh
from clothrf_core.sections import ClothSection
from clothrf_core.types import (
    CameraModel,
    ClothState,
    Float,
    GraspState,
    RgbdFrame,
    RobotCommand,
)

SKIN = (0.60, 0.38, 0.28)
STEEL = (0.35, 0.36, 0.38)
REST_SPREAD = 0.05  # m about the rest corners, in roll-outs that start there


class SimulatedWorld(World):
    """Cloth, person, robot and sensor noise of one roll-out at a time.

    Args:
        simulator: the cloth.
        hands: how the person moves.
        randomizer: what varies between roll-outs.
        rig: where everything stands.
        cloth: the nominal cloth.
        dt: control period, s.
    """

    def __init__(
        self,
        simulator: Simulator,
        hands: HandMotion,
        randomizer: Randomizer,
        rig: Rig,
        cloth: ClothSection,
        dt: float,
    ) -> None:
        self._simulator = simulator
        self._hands = hands
        self._randomizer = randomizer
        self._rig = rig
        self._cloth = cloth
        self._dt = dt
        self._nominal_camera = rig.camera.model()
        self._table = table(rig)
        self._holders = Holders.usual()
        self._state: ClothState | None = None
        self._params: Randomization | None = None
        self._steps = 0

    def reset(self, seed: SeedSequence, start: Expert, *, from_rest: float = 0.0) -> ClothState:
        """Start a roll-out; the robot begins where `start` says it should be.

        With probability `from_rest` it begins near the rig's rest corners instead, as a real one
        does that has just been handed the cloth. Every part gets its own stream of `seed`, so that
        drawing more numbers in one does not change the others.
        """
        motion, cloth, draw, noise, sensor, first = (
            np.random.default_rng(s) for s in seed.spawn(6)
        )
        hands = self._hands.reset(motion)
        corners = ClothState(
            vertices=np.concatenate([hands, self._rig.rest_grasp]),
            velocities=np.zeros((4, 3)),
            hands=hands,
            grasp=self._rig.rest_grasp,
        )
        grasp = np.array(start.label(corners).targets)
        if first.random() < from_rest:
            near = self._rig.rest_grasp + first.uniform(-REST_SPREAD, REST_SPREAD, (2, 3))
            grasp = within_reach(hands, near, 0.98 * self._cloth.size[1])
        self._params = self._randomizer.draw(draw, self.nominal(hands, grasp))
        self._noise_rng, self._sensor_rng = noise, sensor
        self._offset = np.zeros((2, 3))
        self._steps = 0
        self._state = self._simulator.reset(cloth, self._params.simulation)
        return self._state

    def nominal(self, hands: Float, grasp: Float) -> Randomization:
        """What a roll-out from these (2, 3) corners looks like without randomisation."""
        section = self._cloth
        return Randomization(
            simulation=SimulationParams(
                hands=hands,
                grasp=grasp,
                size=section.size,
                resolution=section.resolution,
                fabric=section.fabric.fabric(),
                self_collision=section.self_collision,
                settle_s=section.settle_s,
            ),
            camera=self._nominal_camera,
            cloth_colour=section.colour,
        )

    @property
    def state(self) -> ClothState:
        """The truth; for experts, evaluation and drawing."""
        if self._state is None:
            raise RuntimeError("SimulatedWorld: reset it before use")
        return self._state

    @property
    def params(self) -> Randomization:
        """What was drawn for this roll-out."""
        if self._params is None:
            raise RuntimeError("SimulatedWorld: reset it before use")
        return self._params

    @property
    def arrivals(self) -> int:
        """Hand targets reached in this roll-out."""
        return self._hands.arrivals

    @property
    def stamp_ns(self) -> int:
        """Simulated time, nanoseconds since `reset`."""
        return round(self._steps * self._dt * 1e9)

    @override
    def scene(self) -> Scene:
        state, params = self.state, self.params
        meshes = [
            self._cloth_mesh(state, params),
            *self._holders.at(state),
            self._table_mesh(params),
            *params.occluders,
        ]
        if params.backdrop is not None:
            meshes.append(params.backdrop)
        return Scene(meshes=tuple(meshes), light=params.light, stamp_ns=self.stamp_ns)

    def _cloth_mesh(self, state: ClothState, params: Randomization) -> SceneMesh:
        mesh = self._simulator.mesh()
        plain = cloth_mesh(state, mesh, params.cloth_colour)
        if params.cloth_pattern is None:
            return plain
        return plain.printed(params.cloth_pattern, mesh.rest / np.array(params.simulation.size))

    def _table_mesh(self, params: Randomization) -> SceneMesh:
        if params.table_pattern is None:
            return self._table
        return self._table.printed(params.table_pattern, seen_from_above(self._table))

    @override
    def camera_model(self) -> CameraModel:
        return self.params.camera

    @override
    def grasp(self) -> GraspState:
        return GraspState(positions=np.array(self.state.grasp), stamp_ns=self.stamp_ns)

    @override
    def advance(self, command: RobotCommand) -> None:
        hands = self._hands.step(self._dt) + self._disturbance(self.params)
        self._state = self._simulator.step(np.array(command.targets), hands, self._dt)
        self._steps += 1

    def seen(self, picture: Picture) -> RgbdFrame:
        """The picture as the sensor delivers it: told the nominal camera, disturbed."""
        frame = dataclasses.replace(picture.frame, camera=self._nominal_camera)
        return self._randomizer.corrupt(frame, self.params, self._sensor_rng)

    def _disturbance(self, params: Randomization) -> Float:
        """Offset of the hands at this step, (2, 3) m."""
        noise = params.hand_noise
        if noise.std <= 0.0:
            return self._offset
        process = Disturbance(noise.std, self._dt, noise.time_constant_s)
        self._offset = process.next(self._offset, self._noise_rng)
        return self._offset


class SimulatedCamera(CameraAround):
    """A rendered camera with the world's sensor noise in front of it."""

    def __init__(self, renderer: RenderedCamera, world: SimulatedWorld) -> None:
        super().__init__(renderer)
        self._renderer = renderer
        self._world = world

    @override
    def read(self, timeout_s: float = 1.0) -> RgbdFrame:
        return self._world.seen(self.picture())

    def picture(self) -> Picture:
        """The undisturbed picture with its labels; for evaluation."""
        return self.draw(self._world.camera_model())

    def draw(self, camera: CameraModel) -> Picture:
        """The undisturbed picture from another viewpoint."""
        return self._renderer.render(self._world.scene(), camera)


class SimulatedRobot(NothingToOpen, Robot):
    """Grippers that go where they are told; sending lets one control period pass."""

    def __init__(self, world: World) -> None:
        self._world = world

    @override
    def state(self) -> GraspState:
        return self._world.grasp()

    @override
    def send(self, command: RobotCommand) -> RobotCommand:
        self._world.advance(command)
        return command


@dataclass(frozen=True)
class Disturbance:
    """An Ornstein-Uhlenbeck offset, exact for any dt: of the hands, or of grasp targets."""

    std: float
    dt: float
    time_constant_s: float = 0.3

    def next(self, previous: Float, rng: Generator) -> Float:
        """The next offset after `previous`."""
        decay = np.exp(-self.dt / self.time_constant_s)
        kick = rng.standard_normal(previous.shape) * self.std * np.sqrt(1.0 - decay**2)
        following: Float = decay * previous + kick
        return following


def table(rig: Rig) -> SceneMesh:
    """The rig's table as something to draw."""
    mesh = box(
        np.array(rig.table.low, float),
        np.array(rig.table.high, float),
        Label.TABLE,
        (rig.table.colour[0], rig.table.colour[1], rig.table.colour[2]),
    )
    return dataclasses.replace(mesh, measurable=rig.table.measurable)


def seen_from_above(mesh: SceneMesh) -> Float:
    """(V, 2) places on a pattern that covers `mesh` from above: y to the right, x downwards."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    places: Float = ((mesh.vertices - low) / np.maximum(high - low, 1e-9))[:, 1::-1]
    return places


@dataclass(frozen=True)
class Holders:
    """Hands and grippers as things to draw: capsules at the corners, pointing away from the cloth.

    Attributes:
        hand: a hand with its wrist, from the origin along z.
        gripper: a gripper, from the origin along z.
    """

    hand: SceneMesh
    gripper: SceneMesh

    @classmethod
    def usual(cls) -> Holders:
        """A forearm 44 mm thick, a gripper 28 mm thick."""
        zero, up = np.zeros(3), np.array([0.0, 0.0, 1.0])
        return cls(
            hand=capsule(zero, 0.098 * up, 0.022, Label.HAND, SKIN),
            gripper=capsule(zero, 0.112 * up, 0.014, Label.GRIPPER, STEEL),
        )

    def at(self, state: ClothState) -> list[SceneMesh]:
        """Two hands and two grippers at the corners of `state`."""
        centre = (state.hands.sum(axis=0) + state.grasp.sum(axis=0)) / 4.0
        meshes = []
        for corner in state.hands:
            away = _unit(corner - centre + np.array([0.10, 0.0, -0.02]))
            meshes.append(along(self.hand, corner + 0.012 * away, away))
        for corner in state.grasp:
            away = _unit(corner - centre + np.array([-0.10, 0.0, 0.10]))
            meshes.append(along(self.gripper, corner + 0.008 * away, away))
        return meshes


def within_reach(hands: Float, grasp: Float, length: float) -> Float:
    """(2, 3) `grasp`, each gripper drawn towards its hand until a side of `length` m reaches it."""
    way = grasp - hands
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    reached: Float = hands + way * np.minimum(1.0, length / np.maximum(distance, 1e-9))
    return reached


def _unit(vector: Float) -> Float:
    result: Float = vector / max(float(np.linalg.norm(vector)), 1e-9)
    return result
