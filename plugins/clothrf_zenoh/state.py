"""The bridge's states and the only ways between them.

    DISCONNECTED -> IDLE -> ARMED -> RUNNING -> HOLD      ESTOP, FAULT from everywhere

Motion happens in RUNNING only, and RUNNING is reached only through ARMED, that is through an
explicit request. HOLD never goes back by itself. ESTOP and FAULT stay until they are cleared, even
when the controller comes and goes.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class State(StrEnum):
    """Where the bridge stands."""

    DISCONNECTED = "DISCONNECTED"
    IDLE = "IDLE"
    ARMED = "ARMED"
    RUNNING = "RUNNING"
    HOLD = "HOLD"
    ESTOP = "ESTOP"
    FAULT = "FAULT"


class Event(StrEnum):
    """What moves it."""

    CONNECTED = "connected"  # the robot's controller reports where the arms are
    LOST = "lost"  # the controller went away or restarted
    ARM = "arm"  # a client was granted the arms
    COMMAND = "command"  # the first command of a grant was accepted
    RELEASE = "release"  # the client gave the arms back
    HALT = "halt"  # watchdog, lease, a bad command, a limit ahead
    ESTOP = "estop"  # somebody asked for an emergency stop
    FAIL = "fail"  # the output itself was wrong, or the loop failed
    CLEAR = "clear"  # somebody looked and cleared ESTOP or FAULT


_S, _E = State, Event

TRANSITIONS: Mapping[tuple[State, Event], State] = {
    (_S.DISCONNECTED, _E.CONNECTED): _S.IDLE,
    (_S.IDLE, _E.LOST): _S.DISCONNECTED,
    (_S.ARMED, _E.LOST): _S.DISCONNECTED,
    (_S.RUNNING, _E.LOST): _S.DISCONNECTED,
    (_S.HOLD, _E.LOST): _S.DISCONNECTED,
    (_S.IDLE, _E.ARM): _S.ARMED,
    (_S.HOLD, _E.ARM): _S.ARMED,
    (_S.ARMED, _E.COMMAND): _S.RUNNING,
    (_S.ARMED, _E.RELEASE): _S.IDLE,
    (_S.RUNNING, _E.RELEASE): _S.HOLD,
    (_S.ARMED, _E.HALT): _S.HOLD,
    (_S.RUNNING, _E.HALT): _S.HOLD,
    (_S.ESTOP, _E.CLEAR): _S.IDLE,
    (_S.FAULT, _E.CLEAR): _S.IDLE,
    **{(state, _E.FAIL): _S.FAULT for state in State if state is not _S.ESTOP},
    **{(state, _E.ESTOP): _S.ESTOP for state in State},
}


def after(state: State, event: Event) -> State:
    """The state that `event` leads to; an event without a way changes nothing."""
    return TRANSITIONS.get((state, event), state)
