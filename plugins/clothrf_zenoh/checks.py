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

# Rounding of a limiter that keeps its limits exactly.
ROUNDING = 1e-9

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
        frame_id: what the commands of this grant carry.
    """

    gid: bytes
    epoch: int
    offset_ns: int
    frame_id: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "frame_id", epoch_frame(self.epoch))


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
        command_rows: (lower, upper, velocity) of each joint, as plain numbers: for a row of 14 a
            loop is faster than numpy's calls.
        motion_rows: (lower, upper, most speed, step, acceleration, speed step) of each joint.
        cruising: a^2/j, 1/(2 a), a/(2 j), 1/j of each joint with a = cruise, for `pursue`.
        stopping: the same four with a = acceleration, (J,) each, for `stopping_point`.
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
    command_rows: tuple[tuple[float, ...], ...] = field(init=False, repr=False)
    motion_rows: tuple[tuple[float, ...], ...] = field(init=False, repr=False)
    cruising: tuple[tuple[float, ...], ...] = field(init=False, repr=False)
    stopping: tuple[Float, Float, Float, Float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        v, dt = self.velocity, self.dt
        command = (self.lower, self.upper, v)
        most = (v, v * dt, self.acceleration, self.acceleration * dt)
        motion = (self.lower, self.upper, *(limit + ROUNDING for limit in most))
        object.__setattr__(self, "command_rows", _rows(*command))
        object.__setattr__(self, "motion_rows", _rows(*motion))
        a, c, j = self.acceleration, self.cruise, self.jerk
        object.__setattr__(self, "stopping", (a * a / j, 0.5 / a, 0.5 * a / j, 1.0 / j))
        object.__setattr__(self, "cruising", _rows(c * c / j, 0.5 / c, 0.5 * c / j, 1.0 / j))


def _rows(*columns: Float) -> tuple[tuple[float, ...], ...]:
    return tuple(zip(*(column.tolist() for column in columns), strict=True))


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
    before: list[float],
    elapsed_s: float,
    bounds: Bounds,
) -> Refusal | None:
    """May these arms be asked for this posture and speed?

    Args:
        command: decoded, so names and lengths are right.
        grant: whose command it is.
        before: J angles commanded before, rad.
        elapsed_s: time between the two commands' stamps.
        bounds: what is allowed.
    """
    if command.frame_id != grant.frame_id:
        return Refusal(Reason.EPOCH, "frame_id", grant.frame_id, command.frame_id)
    q, qd = command.positions, command.velocities
    # Two ticks of slack: stamps of a paced stream jitter, its positions do not.
    window = max(elapsed_s, 0.0) + 2.0 * bounds.dt
    columns = zip(q.tolist(), qd.tolist(), before, bounds.command_rows, strict=True)
    for x, speed, old, (low, high, fastest) in columns:
        far = fastest * window
        if not (low <= x <= high and -fastest <= speed <= fastest and -far <= x - old <= far):
            break
    else:
        return None
    names, v = bounds.names, bounds.velocity
    return (
        within("position", q, bounds.lower, bounds.upper, names, Reason.JOINT)
        or within("velocity", qd, -v, v, names, Reason.VELOCITY)
        or within("step", q - np.array(before), -v * window, v * window, names, Reason.JUMP)
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
    dt = bounds.dt
    numbers = (q.tolist(), qd.tolist(), qdd.tolist(), before[0].tolist(), before[1].tolist())
    for x, v, a, x0, v0, row in zip(*numbers, bounds.motion_rows, strict=True):
        low, high, fastest, step_most, hardest, change = row
        if not (
            low <= x <= high
            and -fastest <= v <= fastest
            and -step_most <= x - x0 <= step_most
            and -hardest <= a <= hardest
            and -change <= v - v0 <= change
        ):
            break
    else:
        return None
    step, speed_step = q - before[0], qd - before[1]
    names, v, a = bounds.names, bounds.velocity, bounds.acceleration
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
    far = bounds.following
    for x, y in zip(measured.tolist(), sent.tolist(), strict=True):
        if not -far <= x - y <= far:
            break
    else:
        return None
    error = measured - sent
    reach = np.full(len(sent), bounds.following)
    return below("measured - sent", error, reach, bounds.names, Reason.FOLLOWING)


def pursue(
    pursued: list[float], q: list[float], qd: list[float], bounds: Bounds
) -> tuple[list[float], Float]:
    """One tick of following a client at (q, qd): (the pursued posture, what to head for).

    Each joint of the pursued posture walks towards the client's, a little faster than the client
    itself, so that messages that were late are caught up with gently and not with all the speed
    that the joints have. What is headed for lies ahead of it, where the client would come to rest
    by itself: that takes away the lag which a second limiter behind the client's own would add.
    Symmetric S-curve from speed v: T = v/a + a/j when v > a^2/j, else 2 sqrt(v/j); distance v T/2.
    While much is left to be caught up with, less is looked ahead: both at once would be faster than
    the client ever was.

    Args:
        pursued: J angles of the tick before, rad.
        q: J angles of the newest command.
        qd: J speeds of the newest command, rad/s.
        bounds: accelerations and jerks.
    """
    quick, creep = CATCH_UP * bounds.dt, CREEP * bounds.dt
    walked, target = [], []
    for x, goal, speed, (knee, per_a, rise, per_j) in zip(
        pursued, q, qd, bounds.cruising, strict=True
    ):
        v = speed if speed >= 0.0 else -speed
        ahead = speed * (v * per_a + rise if v > knee else math.sqrt(v * per_j))
        reach = quick * v
        if reach < creep:
            reach = creep
        way = goal - x
        if -reach <= way <= reach:
            x = goal
        else:
            x += reach if way > 0.0 else -reach
            left = abs(goal - x) / (PAUSE_TICKS * reach)
            ahead *= min(max(1.5 - left, 0.0), 1.0)
        walked.append(x)
        target.append(x + ahead)
    return walked, np.array(target)


def stopping_point(q: Float, qd: Float, qdd: Float, bounds: Bounds) -> Float:
    """(J,) where each joint comes to rest if it stops as fast as it may.

    As in `pursue`, but a joint still gaining speed first takes |qdd|/j to let go of it.
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
    good = np.abs(values) <= limit + ROUNDING
    if good.all():
        return None
    i = int(np.argmin(good))
    bad = float(values[i])
    why = reason if np.isfinite(bad) else Reason.NOT_FINITE
    return Refusal(why, f"{field} {names[i]}", f"at most {limit[i]:.4f}", f"{bad:.4f}")
