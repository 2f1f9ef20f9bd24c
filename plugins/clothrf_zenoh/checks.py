"""What may ever reach the arms, as pure functions: each gives a `Refusal` or None.

Order of a command's life: `check_sender` (is it the armed client's, in order, fresh?), then
`check_command` (does it say something these arms may do?), then `pursue` and Ruckig turn it into an
output, and `check_motion`, `check_grippers` and `check_clearance` decide whether that may leave.
Comparisons over all joints are in `compiled`; NaN fails them all. What they found is put into words
here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from clothrf_core.types import Float
from clothrf_zenoh import compiled
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
    CONTROLLER = "controller_lost"
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
        commanded: (3, J) lower, upper, velocity; as `compiled.bad_command` wants it.
        moved: (6, J) lower, upper, and with the limiter's rounding velocity, step, acceleration,
            speed step; as `compiled.bad_motion` wants it.
        cruising: (4, J) S-curve of a joint at acceleration `cruise`; see `compiled.half_stop`.
        stopping: the same at `acceleration`.
        corners: (2, 3) `box`.
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
    commanded: Float = field(init=False, repr=False)
    moved: Float = field(init=False, repr=False)
    cruising: Float = field(init=False, repr=False)
    stopping: Float = field(init=False, repr=False)
    corners: Float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        v, a, dt = self.velocity, self.acceleration, self.dt
        magnitudes = [limit + ROUNDING for limit in (v, v * dt, a, a * dt)]
        object.__setattr__(self, "commanded", np.array([self.lower, self.upper, v]))
        object.__setattr__(self, "moved", np.array([self.lower, self.upper, *magnitudes]))
        object.__setattr__(self, "cruising", _s_curve(self.cruise, self.jerk))
        object.__setattr__(self, "stopping", _s_curve(a, self.jerk))
        object.__setattr__(self, "corners", np.array(self.box, float))


def _s_curve(a: Float, j: Float) -> Float:
    return np.array([a * a / j, 0.5 / a, 0.5 * a / j, 1.0 / j])


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


COMMAND_ROWS = (
    ("position", Reason.JOINT),
    ("velocity", Reason.VELOCITY),
    ("step", Reason.JUMP),
)


def check_command(
    command: JointTrajectory, grant: Grant, before: Float, elapsed_s: float, bounds: Bounds
) -> Refusal | None:
    """May these arms be asked for this posture and speed?

    Args:
        command: decoded, so names and lengths are right.
        grant: whose command it is.
        before: (J,) angles commanded before, rad.
        elapsed_s: time between the two commands' stamps.
        bounds: what is allowed.
    """
    if command.frame_id != grant.frame_id:
        return Refusal(Reason.EPOCH, "frame_id", grant.frame_id, command.frame_id)
    q, qd, limits = command.positions, command.velocities, bounds.commanded
    # Two ticks of slack: stamps of a paced stream jitter, its positions do not.
    window_s = max(elapsed_s, 0.0) + 2.0 * bounds.dt
    bad = compiled.bad_command(q, qd, before, window_s, limits)
    if bad == compiled.GOOD:
        return None
    row, joint = divmod(bad, len(q))
    field, reason = COMMAND_ROWS[row]
    low, high, fastest = limits[:, joint].tolist()
    if row > 0:
        high = fastest * (1.0, window_s)[row - 1]
        low = -high
    value = (q[joint], qd[joint], q[joint] - before[joint])[row]
    return _outside(f"{field} {bounds.names[joint]}", float(value), low, high, reason)


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
    refusal = within("start", q - present, -reach, reach, bounds.names, Reason.START)
    if refusal is not None:
        return refusal
    far = float(np.linalg.norm(points - present_points, axis=1).max())
    if not far <= bounds.start_tcp:
        limit = f"a gripper within {bounds.start_tcp:g} m"
        return Refusal(Reason.START, "start", limit, f"{far:.3f} m")
    return None


MOTION_ROWS = (
    ("output", Reason.JOINT),
    ("speed", Reason.VELOCITY),
    ("step", Reason.VELOCITY),
    ("acceleration", Reason.ACCELERATION),
    ("speed step", Reason.ACCELERATION),
)


def check_motion(
    before: tuple[Float, Float], q: Float, qd: Float, qdd: Float, bounds: Bounds
) -> Refusal | None:
    """Is this output a motion that the joints can do? The numbers themselves and their steps."""
    bad = compiled.bad_motion(*before, q, qd, qdd, bounds.moved)
    if bad == compiled.GOOD:
        return None
    row, joint = divmod(bad, len(q))
    field, reason = MOTION_ROWS[row]
    value = (q, qd, q - before[0], qdd, qd - before[1])[row][joint]
    high = float(bounds.moved[row + 1, joint])
    low = float(bounds.moved[0, joint]) if row == 0 else -high
    return _outside(f"{field} {bounds.names[joint]}", float(value), low, high, reason)


def check_grippers(
    points: Float, points_before: Float, speed_limit: float, bounds: Bounds
) -> Refusal | None:
    """Are both grippers inside their box and slow enough over the last tick?"""
    step = speed_limit * bounds.dt
    bad = compiled.bad_grippers(points, points_before, bounds.corners, step)
    if bad == compiled.GOOD:
        return None
    too_fast, i = divmod(bad, len(points))
    if too_fast:
        speed = float(np.linalg.norm(points[i] - points_before[i])) / bounds.dt
        limit = f"at most {speed_limit:g} m/s"
        return Refusal(Reason.TCP_SPEED, "gripper speed", limit, f"{speed:.3f}")
    low, high = bounds.box
    x, y, z = points[i].tolist()
    inside = f"inside {list(low)} to {list(high)} m"
    return Refusal(Reason.TCP_BOX, "gripper", inside, f"{x:.4f}, {y:.4f}, {z:.4f}")


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
    bad = compiled.far_apart(measured, sent, far)
    if bad == compiled.GOOD:
        return None
    where = f"measured - sent {bounds.names[bad]}"
    return _outside(where, float(measured[bad] - sent[bad]), -far, far, Reason.FOLLOWING)


def pursue(pursued: Float, q: Float, qd: Float, bounds: Bounds) -> tuple[Float, Float]:
    """One tick of following a client at (q, qd): (the pursued posture, what to head for).

    Each joint of the pursued posture walks towards the client's, a little faster than the client
    itself, so that messages that were late are caught up with gently and not with all the speed
    that the joints have. What is headed for lies ahead of it, where the client would come to rest
    by itself: that takes away the lag which a second limiter behind the client's own would add.
    Symmetric S-curve from speed v: T = v/a + a/j when v > a^2/j, else 2 sqrt(v/j); distance v T/2.
    While much is left to be caught up with, less is looked ahead: both at once would be faster than
    the client ever was.

    Args:
        pursued: (J,) posture of the tick before, rad.
        q: (J,) angles of the newest command.
        qd: (J,) speeds of the newest command, rad/s.
        bounds: accelerations and jerks.
    """
    both = np.empty((2, q.size))
    quick, creep = CATCH_UP * bounds.dt, CREEP * bounds.dt
    compiled.walk(pursued, q, qd, bounds.cruising, quick, creep, PAUSE_TICKS, both)
    return both[0], both[1]


def stopping_point(q: Float, qd: Float, qdd: Float, bounds: Bounds) -> Float:
    """(J,) where each joint comes to rest if it stops as fast as it may.

    As in `pursue`, but a joint still gaining speed first takes |qdd|/j to let go of it.
    """
    there = np.empty(q.size)
    compiled.rest(q, qd, qdd, bounds.stopping, there)
    return there


def within(
    field: str, values: Float, low: Float, high: Float, names: tuple[str, ...], reason: Reason
) -> Refusal | None:
    """Every value in its closed interval; NaN is outside."""
    good = (values >= low) & (values <= high)
    if good.all():
        return None
    i = int(np.argmin(good))
    return _outside(f"{field} {names[i]}", float(values[i]), float(low[i]), float(high[i]), reason)


def _outside(where: str, value: float, low: float, high: float, reason: Reason) -> Refusal:
    """`value` is not between `low` and `high`, or no number at all."""
    why = reason if np.isfinite(value) else Reason.NOT_FINITE
    return Refusal(why, where, f"{low:.4f} to {high:.4f}", f"{value:.4f}")
