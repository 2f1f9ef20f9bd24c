"""Stepping a flex whose corners go where they are told, whatever that does to the cloth."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from clothrf_core.types import Float
from clothrf_mujoco.config import FlexOptions
from clothrf_mujoco.flex import Flex

FINER = (1, 4, 16)
"""Times as many substeps, one after the other, where a step ran away."""
MOST = 64
"""Substeps a call before any of that."""
ESCAPE = 3.0
"""A vertex farther from all corners than this many sheet diagonals and corner spans ran away."""
ARRIVED = 1e-6
"""m; a substep that leaves a corner farther from where it is led was stopped by contacts."""
PAUSE = 30
"""Substeps without contacts after one that contacts stopped."""
IPC = int(mujoco.mjtEnableBit.mjENBL_IPC)
CONTACT = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


class Stepper:
    """A cloth in motion.

    MuJoCo linearises once a substep, so corners that jump are led there in strides, and a step
    that runs away is taken back and done in finer ones. If even those fail, the shape is carried
    along with its corners, at rest: numbers stay finite and the next step starts sane.

    Where layers are kept apart but the corners drive them through each other all the same (a corner
    pushed through the sheet), contacts would stop the corners: they are left out for a while.
    """

    def __init__(self, cloth: Flex, options: FlexOptions, vertices: Float, corners: Float) -> None:
        self.cloth = cloth
        self.corners = corners.copy()
        self._options = options
        self._data = mujoco.MjData(cloth.model)
        # MuJoCo writes the first warning of each kind into a file of the present folder.
        for warning in self._data.warning:
            warning.number = 1
        self._data.qpos[:] = (vertices - cloth.flat).ravel()
        self._speed = np.zeros((4, 3))
        self._pause = 0
        self._hold(corners, self._speed)

    def vertices(self) -> Float:
        """(V, 3) world; the corners to the bit where they were told to be."""
        x: Float = self._data.qpos.reshape(-1, 3) + self.cloth.flat
        x[self.cloth.mesh.corners] = self.corners
        return x

    def velocities(self) -> Float:
        """(V, 3) metres a second."""
        v: Float = self._data.qvel.reshape(-1, 3).copy()
        v[self.cloth.mesh.corners] = self._speed
        return v

    def advance(self, corners: Float, dt: float, *, drag: float) -> None:
        """Move the corners linearly to (4, 3) `corners` within `dt` seconds.

        Args:
            corners: hand 0, hand 1, grasp 0, grasp 1, world.
            dt: seconds.
            drag: of the air, 1/s.
        """
        model, data = self.cloth.model, self._data
        model.dof_damping[:] = np.repeat(drag * self.cloth.mass, 3)
        far = float(np.linalg.norm(corners - self.corners, axis=1).max())
        strides = min(int(np.ceil(far / self._options.stride)), MOST)
        before = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
        for times in FINER:
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = before
            if self._lead(corners, dt, times * max(self._options.substeps, strides)):
                break
        else:
            self._carry(corners, before[0])
        self._speed = (corners - self.corners) / dt
        self.corners = corners.copy()

    def _lead(self, corners: Float, dt: float, count: int) -> bool:
        """Take `count` substeps; whether the cloth is still in one piece."""
        self.cloth.model.opt.timestep = dt / count
        speed = (corners - self.corners) / dt
        for i in range(count):
            self._hold(self.corners + (corners - self.corners) * (i / count), speed)
            self._substep()
            if not self._sane(corners):
                return False
        self._hold(corners, speed)
        return True

    def _substep(self) -> None:
        model, data, held = self.cloth.model, self._data, self.cloth.held
        if self.cloth.collides and self._pause == 0:
            before = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
            goal = before[0][held] + model.opt.timestep * before[1][held]
            model.opt.enableflags |= IPC
            model.opt.disableflags &= ~CONTACT
            with _quietly():
                mujoco.mj_step(model, data)
            if np.abs(data.qpos[held] - goal).max() < ARRIVED:
                return
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = before
            self._pause = PAUSE
        self._pause = max(self._pause - 1, 0)
        model.opt.enableflags &= ~IPC
        model.opt.disableflags |= CONTACT
        mujoco.mj_step(model, data)

    def _hold(self, corners: Float, speed: Float) -> None:
        cloth = self.cloth
        self._data.qpos[cloth.held] = (corners - cloth.flat[cloth.mesh.corners]).ravel()
        self._data.qvel[cloth.held] = speed.ravel()

    def _sane(self, corners: Float) -> bool:
        if not (np.isfinite(self._data.qpos).all() and np.isfinite(self._data.qvel).all()):
            return False
        x = self._data.qpos.reshape(-1, 3) + self.cloth.flat
        both = np.concatenate([self.corners, corners])
        span = float(np.linalg.norm(np.ptp(both, axis=0)))
        reach = float(np.linalg.norm(np.ptp(self.cloth.flat, axis=0)))
        return bool(np.abs(x - both.mean(axis=0)).max() < ESCAPE * (span + reach))

    def _carry(self, corners: Float, qpos: Float) -> None:
        """The shape before, bent along with its corners, at rest."""
        cloth, data = self.cloth, self._data
        u, v = (cloth.mesh.rest / cloth.mesh.rest.max(axis=0)).T
        weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
        data.qpos[:] = qpos + (weights @ (corners - self.corners)).ravel()
        data.qvel[:] = 0.0
        data.qacc_warmstart[:] = 0.0
        self._hold(corners, np.zeros((4, 3)))


@contextmanager
def _quietly() -> Iterator[None]:
    """MuJoCo's own words about a stopped step, kept from the terminal and its log file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda words: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
