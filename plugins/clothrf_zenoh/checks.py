"""What may ever reach the arms, as pure functions: each gives a `Refusal` or None.

Order of a command's life: `check_sender` (is it the armed client's, in order, fresh?), then
`check_command` (does it say something these arms may do?), then Ruckig turns it into an output, and
`check_output` decides whether that output may leave. Comparisons are written so that NaN fails.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from clothrf_core.types import Float
from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.messages import JointTrajectory, epoch_frame

# Pursuit of a client: times its own speed, but at least so many rad/s; silent ticks after which it
# begins anew.
CATCH_UP = 1.2
CREEP = 0.1
PAUSE_TICKS = 8


class Reason(StrEnum):
    """Why something was refused; the names under which the bridge counts and publishes."""

    # Not the armed client's business: ignored, so that nobody else can stop the arms with it.
    NOT_ARMED = "not_armed"
    FOREIGN = "foreign_publisher"
    EPOCH = "wrong_epoch"
    SEQUENCE = "old_sequence"
    STALE = "stale_stamp"
    FUTURE = "future_stamp"
    ATTACHMENT = "bad_attachment"
    # The armed client's, but wrong: the arms stop at once.
    MALFORMED = "malformed"
    NOT_FINITE = "not_finite"
    JOINT = "joint_limit"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JUMP = "jump"
    START = "far_from_posture"
    TCP_SPEED = "tcp_speed"
    TCP_BOX = "tcp_box"
    CLEARANCE = "clearance"
    # Nobody's command: why the arms were stopped.
    WATCHDOG = "watchdog"
    LEASE = "lease"
    GAP = "loop_gap"
    FOLLOWING = "following_error"
    INTERNAL = "internal"


IGNORED = frozenset(
    {
        Reason.NOT_ARMED,
        Reason.FOREIGN,
        Reason.EPOCH,
        Reason.SEQUENCE,
        Reason.STALE,
        Reason.FUTURE,
        Reason.ATTACHMENT,
    }
)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why something may not happen.

    Attributes:
        reason: what it is counted as.
        field: which number.
        expected: what would have been allowed.
        found: what was there.
    """

    reason: Reason
    field: str
    expected: str
    found: str

    def __str__(self) -> str:
        return f"{self.field}: expected {self.expected}, found {self.found} ({self.reason})"

    @property
    def halts(self) -> bool:
        """The arms must stop because of it."""
        return self.reason not in IGNORED


@dataclass(frozen=True, slots=True)
class Instant:
    """One moment on two clocks: monotonic for durations, wall for other machines' stamps."""

    mono_ns: int
    wall_ns: int


@dataclass(frozen=True, slots=True)
class Grant:
    """Who holds the arms.

    Attributes:
        gid: 16-byte id of the armed publisher.
        epoch: number of this grant; its commands carry it.
        offset_ns: this machine's wall clock minus the client's, at arming.
    """

    gid: bytes
    epoch: int
    offset_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Everything that is compared against; arrays are (J,) float64 in joint order.

    Attributes:
        names: J joint names.
        lower: soft limit, rad.
        upper: soft limit, rad.
        velocity: rad/s.
        acceleration: rad/s^2, in stops too.
        cruise: rad/s^2, while following targets.
        jerk: rad/s^3.
        dt: period of the loop, s.
        tcp_speed: of each gripper, m/s; above it the arms stop.
        tcp_speed_hard: never sent, m/s.
        box: lowest and highest corner of the grippers' box, world, m.
        clearance: least distance of any pair that is ever sent, m.
        clearance_ahead: the same for the posture where the arms could stop, m.
        max_age_ns: oldest stamp.
        max_future_ns: farthest stamp ahead.
        start_joint: first command's distance from the present posture, rad.
        start_tcp: the same at the grippers, m.
        following: greatest distance between sent and measured posture, rad.
        command_limit: low and high of (q, qd), (2 J,).
        motion_limit: low and high of (q, qd, step, qdd, speed step), (5 J,).
        cruising: a^2/j, 1/(2 a), a/(2 j), 1/j with a = cruise, for `pursuit`.
        stopping: the same with a = acceleration, for `stopping_point`.
    """

    names: tuple[str, ...]
    lower: Float
    upper: Float
    velocity: Float
    acceleration: Float
    cruise: Float
    jerk: Float
    dt: float
    tcp_speed: float
    tcp_speed_hard: float
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    clearance: float
    clearance_ahead: float
    max_age_ns: int
    max_future_ns: int
    start_joint: float
    start_tcp: float
    following: float
    command_limit: tuple[Float, Float] = field(init=False, repr=False)
    motion_limit: tuple[Float, Float] = field(init=False, repr=False)
    cruising: tuple[Float, Float, Float, Float] = field(init=False, repr=False)
    stopping: tuple[Float, Float, Float, Float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        v, a, slack = self.velocity, self.acceleration, 1e-9
        command = (np.concatenate((self.lower, -v)), np.concatenate((self.upper, v)))
        spans = (v, v * self.dt, a, a * self.dt)
        motion = (
            np.concatenate((self.lower, *(-span - slack for span in spans))),
            np.concatenate((self.upper, *(span + slack for span in spans))),
        )
        object.__setattr__(self, "command_limit", command)
        object.__setattr__(self, "motion_limit", motion)
        j = self.jerk
        for name, rate in (("cruising", self.cruise), ("stopping", a)):
            constants = (rate * rate / j, 0.5 / rate, 0.5 * rate / j, 1.0 / j)
            object.__setattr__(self, name, constants)


def check_sender(
    attachment: Attachment, grant: Grant | None, last_sequence: int, now: Instant, bounds: Bounds
) -> Refusal | None:
    """Is this the armed publisher's next command, neither old nor from the future?"""
    if grant is None:
        return Refusal(Reason.NOT_ARMED, "publisher", "nobody while not armed", "a command")
    if attachment.gid != grant.gid:
        return Refusal(Reason.FOREIGN, "gid", grant.gid.hex(), attachment.gid.hex())
    if attachment.sequence <= last_sequence:
        return Refusal(
            Reason.SEQUENCE, "sequence", f"more than {last_sequence}", str(attachment.sequence)
        )
    age = now.wall_ns - (attachment.stamp_ns + grant.offset_ns)
    if age > bounds.max_age_ns:
        return Refusal(
            Reason.STALE, "stamp", f"at most {bounds.max_age_ns / 1e6:g} ms old", f"{age / 1e6:g}"
        )
    if age < -bounds.max_future_ns:
        limit = bounds.max_future_ns / 1e6
        return Refusal(Reason.FUTURE, "stamp", f"at most {limit:g} ms ahead", f"{-age / 1e6:g}")
    return None


def check_command(
    command: JointTrajectory,
    grant: Grant,
    before: Float,
    elapsed_s: float,
    bounds: Bounds,
) -> Refusal | None:
    """May these arms be asked for this posture and speed?

    Args:
        command: decoded, so names and lengths are right.
        grant: whose command it is.
        before: (J,) the posture commanded before, rad.
        elapsed_s: time between the two commands' stamps.
        bounds: what is allowed.
    """
    if command.frame_id != epoch_frame(grant.epoch):
        return Refusal(Reason.EPOCH, "frame_id", epoch_frame(grant.epoch), command.frame_id)
    q, qd = command.positions, command.velocities
    low, high = bounds.command_limit
    everything = np.concatenate((q, qd))
    # Two ticks of slack: stamps of a paced stream jitter, its positions do not.
    window = max(elapsed_s, 0.0) + 2.0 * bounds.dt
    if ((everything >= low) & (everything <= high)).all() and (
        np.abs(q - before) <= bounds.velocity * window
    ).all():
        return None
    names, v = bounds.names, bounds.velocity
    return (
        within("position", q, bounds.lower, bounds.upper, names, Reason.JOINT)
        or within("velocity", qd, -v, v, names, Reason.VELOCITY)
        or within("step", q - before, -v * window, v * window, names, Reason.JUMP)
    )


def check_start(
    q: Float, points: Float, present: Float, present_points: Float, bounds: Bounds
) -> Refusal | None:
    """Does the first command of a grant begin where the arms are?

    Args:
        q: (J,) commanded posture.
        points: (2, 3) grippers there.
        present: (J,) present output.
        present_points: (2, 3) grippers there.
        bounds: what is allowed.
    """
    reach = np.full(len(q), bounds.start_joint)
    refusal = below("start", q - present, reach, bounds.names, Reason.START)
    if refusal is not None:
        return refusal
    far = float(np.linalg.norm(points - present_points, axis=1).max())
    if not far <= bounds.start_tcp:
        limit = f"a gripper within {bounds.start_tcp:g} m"
        return Refusal(Reason.START, "start", limit, f"{far:.3f} m")
    return None


def check_motion(
    before: tuple[Float, Float], q: Float, qd: Float, qdd: Float, bounds: Bounds
) -> Refusal | None:
    """Is this output a motion that the joints can do? The numbers themselves and their steps."""
    step, speed_step = q - before[0], qd - before[1]
    low, high = bounds.motion_limit
    everything = np.concatenate((q, qd, step, qdd, speed_step))
    if ((everything >= low) & (everything <= high)).all():
        return None
    names, v, a, dt = bounds.names, bounds.velocity, bounds.acceleration, bounds.dt
    return (
        within("output", q, bounds.lower, bounds.upper, names, Reason.JOINT)
        or below("speed", qd, v, names, Reason.VELOCITY)
        or below("step", step, v * dt, names, Reason.VELOCITY)
        or below("acceleration", qdd, a, names, Reason.ACCELERATION)
        or below("speed step", speed_step, a * dt, names, Reason.ACCELERATION)
    )


def check_grippers(
    points: Float, points_before: Float, speed_limit: float, bounds: Bounds
) -> Refusal | None:
    """Are both grippers inside their box and slow enough over the last tick?"""
    low, high = bounds.box
    for (x, y, z), (u, v, w) in zip(points.tolist(), points_before.tolist(), strict=True):
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]):
            inside = f"inside {list(low)} to {list(high)} m"
            return Refusal(Reason.TCP_BOX, "gripper", inside, f"{x:.4f}, {y:.4f}, {z:.4f}")
        speed = math.sqrt((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2) / bounds.dt
        if not speed <= speed_limit:
            limit = f"at most {speed_limit:g} m/s"
            return Refusal(Reason.TCP_SPEED, "gripper speed", limit, f"{speed:.3f}")
    return None


def check_clearance(found: tuple[float, str], least: float) -> Refusal | None:
    """Are all bodies far enough apart?"""
    distance, pair = found
    if not distance >= least:
        limit = f"at least {1e3 * least:g} mm"
        return Refusal(Reason.CLEARANCE, f"clearance {pair}", limit, f"{1e3 * distance:.1f} mm")
    return None


def check_following(measured: Float, sent: Float, bounds: Bounds) -> Refusal | None:
    """Are the arms where they were sent?"""
    error = measured - sent
    if np.abs(error).max() <= bounds.following:
        return None
    reach = np.full(len(sent), bounds.following)
    return below("measured - sent", error, reach, bounds.names, Reason.FOLLOWING)


def pursuit(qd: Float, bounds: Bounds) -> tuple[Float, Float]:
    """How a client that moves with `qd` is pursued: (ahead, reach), each (J,), rad.

    ``ahead`` leads from where the client is to where it would come to rest by itself; heading for
    that point takes away the lag that a second limiter behind the client's own would add. Symmetric
    S-curve from speed v: T = v/a + a/j when v > a^2/j, else 2 sqrt(v/j); distance v T/2.

    ``reach`` is how far the pursuit goes in one tick: a little faster than the client, so that
    messages that were late are caught up with gently and not with all the speed the joints have.
    """
    knee, per_a, rise, per_j = bounds.cruising
    v = np.abs(qd)
    ahead = qd * np.where(v > knee, v * per_a + rise, np.sqrt(v * per_j))
    return ahead, np.maximum((CATCH_UP * bounds.dt) * v, CREEP * bounds.dt)


def share_of_lead(left: Float, reach: Float) -> Float:
    """(J,) in [0, 1]: how much of ``ahead`` to keep while ``left`` rad are to be caught up with.

    All of it for the jitter of a busy machine, none of it after a real gap: both at once, catching
    up and looking ahead, would be faster than the client ever was.
    """
    share: Float = np.clip(1.5 - left / (PAUSE_TICKS * reach), 0.0, 1.0)
    return share


def stopping_point(q: Float, qd: Float, qdd: Float, bounds: Bounds) -> Float:
    """(J,) where each joint comes to rest if it stops as fast as it may.

    As in `pursuit`, but a joint still gaining speed first takes |qdd|/j to let go of it.
    """
    knee, per_a, rise, per_j = bounds.stopping
    release = np.maximum(np.sign(qd) * qdd, 0.0) * per_j
    v = np.abs(qd) + 0.5 * bounds.jerk * release * release
    half = np.where(v > knee, v * per_a + rise, np.sqrt(v * per_j))
    return q + np.sign(qd) * v * (release + half)


def within(
    field: str, values: Float, low: Float, high: Float, names: tuple[str, ...], reason: Reason
) -> Refusal | None:
    """Every value in its closed interval; NaN is outside."""
    good = (values >= low) & (values <= high)
    if good.all():
        return None
    i = int(np.argmin(good))
    bad = float(values[i])
    why = reason if np.isfinite(bad) else Reason.NOT_FINITE
    return Refusal(why, f"{field} {names[i]}", f"{low[i]:.4f} to {high[i]:.4f}", f"{bad:.4f}")


def below(
    field: str, values: Float, limit: Float, names: tuple[str, ...], reason: Reason
) -> Refusal | None:
    """Every magnitude at most its limit, to 1e-9 of rounding; NaN is above."""
    good = np.abs(values) <= limit + 1e-9
    if good.all():
        return None
    i = int(np.argmin(good))
    bad = float(values[i])
    why = reason if np.isfinite(bad) else Reason.NOT_FINITE
    return Refusal(why, f"{field} {names[i]}", f"at most {limit[i]:.4f}", f"{bad:.4f}")
