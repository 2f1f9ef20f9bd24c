"""What may ever reach the arms: read this file.

Each 4 ms, `Bridge.tick` gives one posture, and there is no other way to the robot:

    command ── check_sender ── check_command ──> newest command
    newest command ── pursue ── limiter (speed, acceleration, jerk) ──> candidate
    candidate ── check_motion ── check_grippers ── check_clearance ──> output

A command that fails is refused, counted and, if it came from the armed client, stops the arms along
the limiter's jerk-limited stop. A candidate that fails is never sent: the last good output is
repeated with zero speed, and only a person's `clear` ends that. A look-ahead stops the arms while a
stop still ends inside all limits, so this last resort is not met in normal work.

Nothing here knows Zenoh, EGM or the time of day: bytes, measurements and instants come in as
arguments, so that every rule can be tested without waiting. Not safety rated: the pendant's
emergency stop and the three-position switch remain the only real ones.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from clothrf_core.interfaces import ArmModel, JointLimiter
from clothrf_core.types import Float
from clothrf_zenoh import checks
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.checks import Bounds, Grant, Instant, Reason, Refusal
from clothrf_zenoh.faults import BridgeRefused, MalformedMessage
from clothrf_zenoh.messages import JointTrajectoryCodec
from clothrf_zenoh.state import Event, State, after

MOVING = frozenset({State.ARMED, State.RUNNING})
GONE = Refusal(Reason.CONTROLLER, "controller", "measurements of both arms", "none")

# Ticks between two looks ahead; at 0.25 m/s a gripper moves 3 mm in this time.
LOOK_EVERY = 3


@dataclass(slots=True)
class Tally:
    """What has happened since the bridge was made; counters only, so memory stays flat.

    Attributes:
        accepted: commands that became the newest command.
        lost: gaps in the armed client's sequence.
        refused: refusals by reason.
        stops: halts by reason.
        least_clearance: smallest clearance of any output, m.
        last: the latest refusal in words, "" before the first.
    """

    accepted: int = 0
    lost: int = 0
    refused: Counter[Reason] = field(default_factory=Counter)
    stops: Counter[Reason] = field(default_factory=Counter)
    least_clearance: float = float("inf")
    last: str = ""


@dataclass(slots=True)
class _Newest:
    """The newest accepted command of the present grant.

    Attributes:
        angles: (J,) commanded angles, rad.
        speeds: (J,) commanded speeds, rad/s.
        stamp_ns: the client's wall clock.
        mono_ns: when it was accepted.
    """

    angles: Float
    speeds: Float
    stamp_ns: int
    mono_ns: int


class Bridge:
    """Decides each tick what the arms are told.

    Args:
        arm: kinematics and limits.
        bounds: everything that is compared against.
        watchdog_s: after this long without an accepted command the arms stop.
        max_gap_s: after a loop pause longer than this the arms stop.
        first_epoch: number of the first grant; differs after every start of the bridge.
    """

    def __init__(
        self,
        arm: ArmModel,
        bounds: Bounds,
        *,
        watchdog_s: float = 0.1,
        max_gap_s: float = 0.1,
        first_epoch: int = 1,
    ) -> None:
        self.state = State.DISCONNECTED
        self.why = ""
        self.tally = Tally()
        self.grant: Grant | None = None
        self.bounds = bounds
        self._arm = arm
        self._codec = JointTrajectoryCodec(arm.joint_names)
        # A last command may have waited a tick to be read, and ticks jitter: noticed this much
        # earlier, the client's own silence never lasts longer than `watchdog_s` and one tick.
        self._watchdog_ns = int(1e9 * (watchdog_s - 1.5 * bounds.dt))
        self._max_gap_ns = int(1e9 * max_gap_s)
        # After so many silent ticks the pursuit begins anew, from where the arms are.
        self._pause_ns = int(1e9 * checks.PAUSE_TICKS * bounds.dt)
        self._epoch = first_epoch
        self._sequence = 0
        self._last_gid = b""
        self._lease_ns = 0
        self._lease_until_ns = 0
        self._newest: _Newest | None = None
        self._limiter: JointLimiter | None = None
        self._output: tuple[Float, Float] | None = None
        self._points = np.zeros((2, 3))
        self._pursued = np.zeros(0)
        self._measured: Float | None = None
        self._lost = False
        self._last_tick_ns: int | None = None
        self._since_look = 0

    # ---- commands -------------------------------------------------------------------------------

    def receive(self, attachment: bytes | None, payload: bytes, now: Instant) -> Refusal | None:
        """Take one command off the wire; returns why it was refused, or None."""
        refusal = self._accept(attachment, payload, now)
        if refusal is not None:
            self.tally.refused[refusal.reason] += 1
            self.tally.last = str(refusal)
            if refusal.halts:
                self._halt(refusal)
        return refusal

    def _accept(self, attachment: bytes | None, payload: bytes, now: Instant) -> Refusal | None:
        try:
            sender = Attachment.decode(attachment)
        except MalformedMessage as error:
            return Refusal(Reason.ATTACHMENT, error.field, error.expected, error.found)
        grant = self.grant
        refusal = checks.check_sender(sender, grant, self._sequence, now, self.bounds)
        if refusal is not None or grant is None or self._output is None:
            return refusal
        try:
            command = self._codec.decode(payload)
        except MalformedMessage as error:
            return Refusal(Reason.MALFORMED, error.field, error.expected, error.found)
        newest, present, q = self._newest, self._output[0], command.positions
        # The first command is measured against the arms instead, by `check_start`.
        before = q if newest is None else newest.angles
        elapsed_s = 0.0 if newest is None else 1e-9 * (sender.stamp_ns - newest.stamp_ns)
        refusal = checks.check_command(command, grant, before, elapsed_s, self.bounds)
        if refusal is None and newest is None:
            points = self._grippers(q)
            refusal = checks.check_start(q, points, present, self._points, self.bounds)
        if refusal is not None:
            return refusal
        if newest is not None:
            self.tally.lost += sender.sequence - self._sequence - 1
        self._sequence = sender.sequence
        self.tally.accepted += 1
        if newest is None or now.mono_ns - newest.mono_ns > self._pause_ns:
            self._pursued = present
        self._newest = _Newest(q, command.velocities, sender.stamp_ns, now.mono_ns)
        self._go(Event.COMMAND)
        return None

    # ---- requests -------------------------------------------------------------------------------

    def request_arms(
        self, *, gid: bytes, sequence: int, stamp_ns: int, lease_s: float, now: Instant
    ) -> Grant:
        """Grant the arms to the publisher `gid`.

        Args:
            gid: id that its commands carry.
            sequence: the last sequence number it has used.
            stamp_ns: its wall clock now; commands' ages are measured against it.
            lease_s: without `renew` for so long, the arms stop.
            now: the present.

        Raises:
            BridgeRefused: the arms are not free, not at rest or not where they may start.
        """
        if after(self.state, Event.ARM) is self.state:
            raise BridgeRefused(f"expected state IDLE or HOLD, found {self._plainly()}")
        if self._output is None or self._measured is None or not self.at_rest:
            raise BridgeRefused("expected arms at rest, found them moving; ask again")
        q = self._output[0]
        refusal = (
            checks.within(
                "posture", q, self.bounds.lower, self.bounds.upper, self.bounds.names, Reason.JOINT
            )
            or checks.check_following(self._measured, q, self.bounds)
            or checks.check_grippers(self._points, self._points, np.inf, self.bounds)
            or checks.check_clearance(self._arm.clearance(q), self.bounds.clearance)
        )
        if refusal is not None:
            self.tally.refused[refusal.reason] += 1
            raise BridgeRefused(f"the arms may not start here: {refusal}")
        self._sequence = max(self._sequence, sequence) if gid == self._last_gid else sequence
        self._last_gid = gid
        self.grant = Grant(gid, self._epoch, now.wall_ns - stamp_ns)
        self._epoch = (self._epoch + 1) & 0xFFFFFFFF
        self._lease_ns = int(1e9 * lease_s)
        self._lease_until_ns = now.mono_ns + self._lease_ns
        self._newest = None
        self._limiter = self._arm.limiter(self.bounds.dt, q=q)
        self.why = ""
        self._go(Event.ARM)
        return self.grant

    def renew(self, *, gid: bytes, epoch: int, now: Instant) -> None:
        """Keep the lease.

        Raises:
            BridgeRefused: the grant has ended; ask for the arms again.
        """
        self._demand(gid, epoch)
        self._lease_until_ns = now.mono_ns + self._lease_ns

    def release(self, *, gid: bytes, epoch: int) -> None:
        """Give the arms back; they stop if they move.

        Raises:
            BridgeRefused: the grant is not the caller's.
        """
        self._demand(gid, epoch)
        self.why = "released"
        self._go(Event.RELEASE)

    def emergency_stop(self, who: str) -> None:
        """Stop from whatever state, until cleared."""
        self.why = f"emergency stop asked for by {who}"
        self._go(Event.ESTOP)

    def clear(self) -> None:
        """Leave ESTOP or FAULT and take the posture anew from the next measurement.

        Raises:
            BridgeRefused: the arms still move or belong to somebody.
        """
        if self.state in MOVING or not self.at_rest:
            raise BridgeRefused(f"expected arms at rest and free, found {self._plainly()}")
        self.why = ""
        self._output = None
        self._limiter = None
        self._go(Event.CLEAR)

    def _demand(self, gid: bytes, epoch: int) -> None:
        grant = self.grant
        if grant is None or self.state not in MOVING or (grant.gid, grant.epoch) != (gid, epoch):
            raise BridgeRefused(f"expected the holder of the arms, found {self._plainly()}")

    def _plainly(self) -> str:
        return f"{self.state} ({self.why})" if self.why else str(self.state)

    # ---- the tick -------------------------------------------------------------------------------

    def tick(
        self, now: Instant, measured: tuple[Float, Float] | None
    ) -> tuple[Float, Float] | None:
        """What the arms are told now.

        Args:
            now: the present.
            measured: (q, qd) of the arms, None while a controller of them is missing: arms in
                motion are then stopped, and what is measured next is where all begins anew.

        Returns:
            (q, qd), each (J,), or None when there is nobody to tell.
        """
        gap_ns = 0 if self._last_tick_ns is None else now.mono_ns - self._last_tick_ns
        self._last_tick_ns = now.mono_ns
        self._measured = None if measured is None else np.array(measured[0], float)
        if self._measured is None:
            # Perhaps only one arm's controller went: the other is stopped gently first.
            self._lost = True
            self._halt(GONE)
        if self._lost and self.at_rest:
            self._disconnect()
        if self._output is None:
            if self._measured is None:
                return None
            self._adopt(self._measured)
        self._watch(now, gap_ns)
        if self._limiter is not None and (self.state is State.RUNNING or not self.at_rest):
            try:
                self._move(self._limiter)
            except Exception as error:  # noqa: BLE001  whatever fails, the arms hold
                found = f"{type(error).__name__}: {error}"
                self._fail(Refusal(Reason.INTERNAL, "motion", "an output", found))
        return self._output

    @property
    def at_rest(self) -> bool:
        """Nothing moves."""
        return self._limiter is None or self._limiter.at_rest

    @property
    def output(self) -> tuple[Float, Float] | None:
        """(q, qd) told last."""
        return self._output

    def _watch(self, now: Instant, gap_ns: int) -> None:
        """Is everybody still there? The only place where silence turns into a stop."""
        if self.state not in MOVING or self._output is None or self._measured is None:
            return
        refusal: Refusal | None = None
        newest = self._newest
        if newest is not None and now.mono_ns - newest.mono_ns > self._watchdog_ns:
            age = 1e-6 * (now.mono_ns - newest.mono_ns)
            limit = f"at most {1e-6 * self._watchdog_ns:g} ms"
            refusal = Refusal(Reason.WATCHDOG, "age of the newest command", limit, f"{age:.1f} ms")
        elif now.mono_ns > self._lease_until_ns:
            refusal = Refusal(Reason.LEASE, "lease", "a renewal", "none in time")
        elif gap_ns > self._max_gap_ns:
            limit = f"at most {1e-6 * self._max_gap_ns:g} ms"
            refusal = Refusal(Reason.GAP, "pause of the loop", limit, f"{1e-6 * gap_ns:.1f} ms")
        else:
            refusal = checks.check_following(self._measured, self._output[0], self.bounds)
        if refusal is not None:
            self._halt(refusal)

    def _move(self, limiter: JointLimiter) -> None:
        """Advance one tick; the output changes only if the candidate passes every check."""
        assert self._output is not None
        newest = self._newest
        if self.state is State.RUNNING and newest is not None:
            self._pursued, target = checks.pursue(
                self._pursued, newest.angles, newest.speeds, self.bounds
            )
            q, qd, qdd = limiter.tick(target)
        else:
            q, qd, qdd = limiter.stop()
        bounds = self.bounds
        points = self._grippers(q)
        distance = self._arm.clearance(q)
        refusal = (
            checks.check_motion(self._output, q, qd, qdd, bounds)
            or checks.check_grippers(points, self._points, bounds.tcp_speed_hard, bounds)
            or checks.check_clearance(distance, bounds.clearance)
        )
        if refusal is not None:
            self._fail(refusal)
            return
        self.tally.least_clearance = min(self.tally.least_clearance, distance[0])
        if self.state is State.RUNNING:
            ahead = checks.check_grippers(points, self._points, bounds.tcp_speed, bounds)
            self._since_look = (self._since_look + 1) % LOOK_EVERY
            if ahead is None and self._since_look == 0:
                ahead = self._look_ahead(q, qd, qdd, distance[0])
            if ahead is not None:
                self._halt(ahead)
        self._output = (q, qd)
        self._points = points

    def _look_ahead(self, q: Float, qd: Float, qdd: Float, distance: float) -> Refusal | None:
        """Would a stop begun now end inside the box and clear of everything?

        Every third tick. Bodies that are close but move apart are no reason to stop.
        """
        rest = checks.stopping_point(q, qd, qdd, self.bounds)
        points = self._grippers(rest)
        refusal = checks.check_grippers(points, points, np.inf, self.bounds)
        if refusal is None:
            least = min(self.bounds.clearance_ahead, distance - 1e-4)
            refusal = checks.check_clearance(self._arm.clearance(rest), least)
        return refusal

    def _grippers(self, q: Float) -> Float:
        """(2, 3) where both are at `q`, whatever array the arm model keeps them in."""
        return np.array(self._arm.grasp_points(q), float, order="C")

    # ---- changes of state -----------------------------------------------------------------------

    def _adopt(self, q: Float) -> None:
        """Begin where the arms are; nothing moves until somebody is granted them."""
        self._output = (q, np.zeros(len(q)))
        self._points = self._grippers(q)
        self._limiter = None
        self._go(Event.CONNECTED)

    def _disconnect(self) -> None:
        self._output = None
        self._limiter = None
        self._lost = False
        if self.state not in (State.DISCONNECTED, State.ESTOP, State.FAULT):
            self.why = str(GONE)
        self._go(Event.LOST)

    def _halt(self, refusal: Refusal) -> None:
        if after(self.state, Event.HALT) is not self.state:
            self.tally.stops[refusal.reason] += 1
            self.why = str(refusal)
            self._go(Event.HALT)

    def _fail(self, refusal: Refusal) -> None:
        """The last resort: repeat the last good posture with zero speed until cleared."""
        assert self._output is not None
        self.tally.refused[refusal.reason] += 1
        self.tally.stops[refusal.reason] += 1
        self.tally.last = self.why = str(refusal)
        self._output = (self._output[0], np.zeros(len(self._output[0])))
        self._limiter = None
        self._go(Event.FAIL)

    def _go(self, event: Event) -> None:
        self.state = after(self.state, event)
        if self.state not in MOVING:
            self.grant = None
            self._newest = None
