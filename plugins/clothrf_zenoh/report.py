"""How the bridge is, as numbers for people and as a ROS 2 diagnostics message."""

from __future__ import annotations

from collections.abc import Mapping

from clothrf_zenoh.bridge import Bridge
from clothrf_zenoh.messages import DiagnosticArray, DiagnosticStatus
from clothrf_zenoh.pace import Pace
from clothrf_zenoh.state import State

_LEVELS: Mapping[State, int] = {State.HOLD: 1, State.ESTOP: 2, State.FAULT: 2}


def status_of(
    bridge: Bridge, pace: Pace, end: Mapping[str, float], *, epoch: int
) -> dict[str, str | float]:
    """Everything worth knowing, name -> value; times in microseconds, clearance in metres."""
    late, work, tally = pace.lateness.spread(), pace.work.spread(), bridge.tally
    values: dict[str, str | float] = {
        "state": str(bridge.state),
        "reason": bridge.why,
        "at_rest": str(bridge.at_rest),
        "epoch": epoch,
        "ticks": pace.ticks,
        "overruns": pace.overruns,
        "lateness_p50_us": round(late.p50, 1),
        "lateness_p99_us": round(late.p99, 1),
        "lateness_max_us": round(late.max, 1),
        "work_p50_us": round(work.p50, 1),
        "work_p99_us": round(work.p99, 1),
        "work_max_us": round(work.max, 1),
        "accepted": tally.accepted,
        "lost": tally.lost,
        "least_clearance_m": round(min(tally.least_clearance, 9.0), 4),
        "last_refusal": tally.last,
    }
    values |= {f"refused.{reason}": count for reason, count in tally.refused.items()}
    values |= {f"stopped.{reason}": count for reason, count in tally.stops.items()}
    values |= {f"end.{name}": round(value, 6) for name, value in end.items()}
    return values


def diagnostics_of(
    status: Mapping[str, str | float], *, stamp_ns: int, hardware: str
) -> DiagnosticArray:
    """The same as a message that ROS 2 tools show."""
    state = State(str(status["state"]))
    text = f"{state}: {status['reason']}" if status["reason"] else str(state)
    values = tuple((name, str(value)) for name, value in status.items())
    level = _LEVELS.get(state, 0)
    return DiagnosticArray(
        stamp_ns, "", (DiagnosticStatus(level, "clothrf bridge", text[:400], hardware, values),)
    )
