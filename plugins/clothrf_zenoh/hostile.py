"""A million commands that must not move the arms: stale, foreign, broken, out of order, absurd.

Half of them carry the armed publisher's id, as an attacker who has seen the stream would. A command
of the armed publisher that is wrong in itself stops the arms; they are then asked for again, so
that every command meets an armed bridge.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

import numpy as np

from clothrf_core.interfaces import ArmModel
from clothrf_core.provider import Figure
from clothrf_core.registry import Registry
from clothrf_core.types import Float
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.bridge import Bridge
from clothrf_zenoh.checks import Instant
from clothrf_zenoh.compose import bounds_of
from clothrf_zenoh.config import LimitsSection
from clothrf_zenoh.messages import (
    JointState,
    JointTrajectoryCodec,
    encode_joint_state,
    epoch_frame,
)
from clothrf_zenoh.state import State

MS = 1_000_000
DT_NS = 4 * MS
WALL_NS = 10**18
GID = bytes(range(16))
Command = tuple[bytes | None, bytes]


class Attacker:
    """Makes hostile commands against one armed bridge.

    Args:
        arm: whose joints are named.
        rng: decides everything.
    """

    def __init__(self, arm: ArmModel, rng: np.random.Generator) -> None:
        self._rng = rng
        self._arm = arm
        self._codec = JointTrajectoryCodec(tuple(arm.joint_names))
        self._q = arm.ready
        names = tuple(arm.joint_names)
        self._other = JointTrajectoryCodec(names[::-1])
        self._fewer = JointTrajectoryCodec(names[:-1])
        kinds: dict[str, Callable[[int, int, int], Command]] = {
            "foreign": self._foreign,
            "duplicate": self._duplicate,
            "reordered": self._reordered,
            "stale": self._stale,
            "future": self._future,
            "other_epoch": self._other_epoch,
            "no_attachment": self._no_attachment,
            "not_finite": self._not_finite,
            "huge": self._huge,
            "jump": self._jump,
            "too_fast": self._too_fast,
            "truncated": self._truncated,
            "longer": self._longer,
            "flipped": self._flipped,
            "wrong_names": self._wrong_names,
            "wrong_length": self._wrong_length,
            "wrong_type": self._wrong_type,
            "random_bytes": self._random_bytes,
        }
        self.kinds = MappingProxyType(kinds)

    def mixture(self) -> tuple[Callable[[int, int, int], Command], ...]:
        """What does not stop the arms is sent four times as often, to meet them in motion."""
        quiet = ("foreign", "duplicate", "reordered", "stale", "future", "other_epoch")
        often = [self.kinds[name] for name in (*quiet, "no_attachment")]
        rest = [make for make in self.kinds.values() if make not in often]
        return (*often, *often, *often, *often, *rest)

    def _number(self, low: int, high: int) -> int:
        return int(self._rng.integers(low, high))

    def _attached(self, sequence: int, now_ns: int, gid: bytes = GID) -> bytes:
        return Attachment(sequence, WALL_NS + now_ns, gid).encode()

    def _payload(self, epoch: int, now_ns: int, q: Float, qd: Float | None = None) -> bytes:
        speed = np.zeros(len(q)) if qd is None else qd
        return self._codec.encode(WALL_NS + now_ns, epoch_frame(epoch), q, speed, DT_NS)

    def _near(self) -> Float:
        near: Float = self._q + self._rng.uniform(-1e-3, 1e-3, len(self._q))
        return near

    def _with(self, value: float) -> Float:
        q = self._q.copy()
        q[self._number(0, len(q))] = value
        return q

    def honest(self, sequence: int, epoch: int, now_ns: int) -> Command:
        """What the armed client sends: stay where you are."""
        return self._attached(sequence, now_ns), self._payload(epoch, now_ns, self._q)

    def _foreign(self, sequence: int, epoch: int, now_ns: int) -> Command:
        gid = self._rng.bytes(16)
        return self._attached(sequence + 1, now_ns, gid), self._payload(epoch, now_ns, self._near())

    def _duplicate(self, sequence: int, epoch: int, now_ns: int) -> Command:
        return self._attached(sequence, now_ns), self._payload(epoch, now_ns, self._near())

    def _reordered(self, sequence: int, epoch: int, now_ns: int) -> Command:
        old = sequence - self._number(1, 2**62)
        return self._attached(old, now_ns), self._payload(epoch, now_ns, self._near())

    def _stale(self, sequence: int, epoch: int, now_ns: int) -> Command:
        old = now_ns - self._number(101 * MS, 2**58)
        return self._attached(sequence + 1, old), self._payload(epoch, now_ns, self._near())

    def _future(self, sequence: int, epoch: int, now_ns: int) -> Command:
        soon = now_ns + self._number(21 * MS, 2**58)
        return self._attached(sequence + 1, soon), self._payload(epoch, now_ns, self._near())

    def _other_epoch(self, sequence: int, epoch: int, now_ns: int) -> Command:
        other = (epoch + self._number(1, 2**31)) & 0xFFFFFFFF
        return self._attached(sequence + 1, now_ns), self._payload(other, now_ns, self._near())

    def _no_attachment(self, sequence: int, epoch: int, now_ns: int) -> Command:
        data = self._rng.bytes(self._number(0, 33))
        return (data or None), self._payload(epoch, now_ns, self._near())

    def _not_finite(self, sequence: int, epoch: int, now_ns: int) -> Command:
        bad = self._with((np.nan, np.inf, -np.inf)[self._number(0, 3)])
        first = self._number(0, 2)
        payload = (
            self._payload(epoch, now_ns, bad)
            if first
            else self._payload(epoch, now_ns, self._q, bad - self._q)
        )
        return self._attached(sequence + 1, now_ns), payload

    def _huge(self, sequence: int, epoch: int, now_ns: int) -> Command:
        bad = self._with(float(10.0 ** self._number(1, 308)))
        return self._attached(sequence + 1, now_ns), self._payload(epoch, now_ns, bad)

    def _jump(self, sequence: int, epoch: int, now_ns: int) -> Command:
        bad = self._with(float(self._q.max() + self._rng.uniform(3.2, 4.0)))
        return self._attached(sequence + 1, now_ns), self._payload(epoch, now_ns, bad)

    def _too_fast(self, sequence: int, epoch: int, now_ns: int) -> Command:
        speed = self._with(float(self._rng.uniform(8.0, 1e6)))
        payload = self._payload(epoch, now_ns, self._q, speed)
        return self._attached(sequence + 1, now_ns), payload

    def _truncated(self, sequence: int, epoch: int, now_ns: int) -> Command:
        payload = self._payload(epoch, now_ns, self._near())
        return self._attached(sequence + 1, now_ns), payload[: self._number(0, len(payload))]

    def _longer(self, sequence: int, epoch: int, now_ns: int) -> Command:
        payload = self._payload(epoch, now_ns, self._near()) + self._rng.bytes(self._number(1, 900))
        return self._attached(sequence + 1, now_ns), payload

    def _flipped(self, sequence: int, epoch: int, now_ns: int) -> Command:
        payload = bytearray(self._payload(epoch, now_ns, self._near()))
        payload[self._number(0, 4)] ^= self._number(1, 256)
        return self._attached(sequence + 1, now_ns), bytes(payload)

    def _wrong_names(self, sequence: int, epoch: int, now_ns: int) -> Command:
        zeros = np.zeros(len(self._q))
        payload = self._other.encode(WALL_NS + now_ns, epoch_frame(epoch), self._q, zeros)
        return self._attached(sequence + 1, now_ns), payload

    def _wrong_length(self, sequence: int, epoch: int, now_ns: int) -> Command:
        q = self._q[:-1]
        payload = self._fewer.encode(WALL_NS + now_ns, epoch_frame(epoch), q, np.zeros(len(q)))
        return self._attached(sequence + 1, now_ns), payload

    def _wrong_type(self, sequence: int, epoch: int, now_ns: int) -> Command:
        state = JointState(
            WALL_NS + now_ns, epoch_frame(epoch), tuple(self._arm.joint_names), self._q
        )
        return self._attached(sequence + 1, now_ns), encode_joint_state(state)

    def _random_bytes(self, sequence: int, epoch: int, now_ns: int) -> Command:
        return self._attached(sequence + 1, now_ns), self._rng.bytes(self._number(0, 1200))


def attack(arm: ArmModel, count: int, seed: int) -> dict[str, float]:
    """Send `count` hostile commands into a running stream; what happened, by name.

    The armed client itself stands still, with one good command in fifty. ``executed`` counts
    hostile commands that were accepted and ticks whose output moved; ``memory_growth_kb`` is the
    growth of the process's resident memory after the first tenth.
    """
    bridge = Bridge(arm, bounds_of(arm, LimitsSection(), 1e-9 * DT_NS))
    attacker = Attacker(arm, np.random.default_rng(seed))
    kinds = attacker.mixture()
    start = (arm.ready, np.zeros(len(arm.ready)))
    now_ns, sequence, honest = 10**15, 0, 0
    executed = crashes = armed = memory = 0
    bridge.tick(Instant(now_ns, WALL_NS + now_ns), start)
    began = time.thread_time()
    for i in range(count):
        now = Instant(now_ns, WALL_NS + now_ns)
        if bridge.grant is None:
            bridge.request_arms(
                gid=GID, sequence=sequence, stamp_ns=now.wall_ns, lease_s=1e6, now=now
            )
            armed += 1
        assert bridge.grant is not None
        epoch = bridge.grant.epoch
        if bridge.state is State.ARMED or i % 50 == 0:
            sequence += 1
            honest += bridge.receive(*attacker.honest(sequence, epoch, now_ns), now) is None
        try:
            refusal = bridge.receive(*kinds[i % len(kinds)](sequence, epoch, now_ns), now)
        except Exception:  # noqa: BLE001  whatever it is, it is counted
            crashes += 1
            continue
        # What halts has passed the check of its sender and used up its number.
        sequence += refusal is None or refusal.halts
        executed += refusal is None
        if i % 50 == 0:
            now_ns += DT_NS
            output = bridge.tick(Instant(now_ns, WALL_NS + now_ns), start)
            executed += output is None or not np.array_equal(output[0], start[0])
        if i == count // 10:
            memory = _resident_kb()
    return {
        "executed": float(executed + bridge.tally.accepted - honest),
        "sent": float(count),
        "refused": float(sum(bridge.tally.refused.values())),
        "crashes": float(crashes),
        "honest_commands_accepted": float(honest),
        "armed_again": float(armed - 1),
        "memory_growth_kb": float(_resident_kb() - memory),
        "us_each": 1e6 * (time.thread_time() - began) / count,
        **{f"refused_{reason}": float(n) for reason, n in bridge.tally.refused.items()},
    }


def hostile(*, quick: bool) -> list[Figure]:
    """`hostile_executed`: of one million (quick: 20,000) hostile commands."""
    arm: ArmModel = Registry.installed().build("arm", "yumi")
    result = attack(arm, 20_000 if quick else 1_000_000, seed=20260101)
    return [Figure("hostile_executed", result.pop("executed"), "commands", result)]


def _resident_kb() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024
