"""A bridge on a table: no network, no time but the one that a test turns by hand."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.bridge import Bridge
from clothrf_zenoh.checks import Instant
from clothrf_zenoh.compose import bounds_of
from clothrf_zenoh.config import LimitsSection
from clothrf_zenoh.messages import JointTrajectoryCodec, epoch_frame

from clothrf_core.testing.arms import CraneArms, PerfectEnd

DT = 0.004
ZERO = np.zeros(14)
GID = bytes(range(16))
OTHER = bytes(16)
MS = 1_000_000


@dataclass
class Bench:
    """One bridge, one client, one controller, one hand-turned clock."""

    arm: CraneArms = field(default_factory=CraneArms)
    limits: LimitsSection = field(default_factory=LimitsSection)
    now_ns: int = 10**9
    sequence: int = 0
    epoch: int = 0

    def __post_init__(self):
        self.bounds = bounds_of(self.arm, self.limits, DT)
        self.bridge = Bridge(self.arm, self.bounds, first_epoch=7)
        self.codec = JointTrajectoryCodec(self.arm.joint_names)
        self.end = PerfectEnd(self.arm.ready)

    @property
    def now(self):
        return Instant(self.now_ns, 10**18 + self.now_ns)

    def tick(self, count=1, *, dt_ns=4 * MS):
        for _ in range(count):
            self.now_ns += dt_ns
            out = self.bridge.tick(self.now, self.end.measured())
            if out is not None:
                self.end.put(*out)
        return self.bridge.output

    def arm_it(self, gid=GID, lease_s=1000.0):
        grant = self.bridge.request_arms(
            gid=gid,
            sequence=self.sequence,
            stamp_ns=self.now.wall_ns,
            lease_s=lease_s,
            now=self.now,
        )
        self.epoch = grant.epoch
        return grant

    def payload(self, q, qd=ZERO, epoch=None):
        frame = epoch_frame(self.epoch if epoch is None else epoch)
        return self.codec.encode(self.now.wall_ns, frame, q, qd, 4 * MS)

    def command(
        self, q=ZERO, qd=ZERO, *, gid=GID, step=1, age_ns=0, epoch=None, payload=None, attach=None
    ):
        self.sequence += step
        if attach is None:
            attach = Attachment(self.sequence, self.now.wall_ns - age_ns, gid).encode()
        if payload is None:
            payload = self.payload(np.asarray(q, float), np.asarray(qd, float), epoch)
        return self.bridge.receive(attach, payload, self.now)

    def run_to(self, q, ticks=500):
        """Stream a paced motion to `q`, as an honest client would."""
        limiter = self.arm.limiter(DT, q=self.bridge.output[0])
        for _ in range(ticks):
            at, speed, _ = limiter.tick(np.asarray(q, float))
            refusal = self.command(at, 0.999 * speed)
            assert refusal is None, refusal
            self.tick()

    def running(self):
        self.tick(2)
        self.arm_it()
        assert self.command() is None
        self.tick()
        return self


@pytest.fixture
def bench():
    return Bench()


@pytest.fixture
def running(bench):
    return bench.running()
