"""Questions to the bridge and its answers: small JSON texts on Zenoh queries.

arm      {"gid": 32 hex digits, "sequence": n, "stamp_ns": t, "lease_s": s}  -> epoch, posture
renew    {"gid": ..., "epoch": n}      keeps the lease
release  {"gid": ..., "epoch": n}      gives the arms back
estop    {"who": text}                 stops from whatever state; needs no grant
clear    {}                            leaves ESTOP or FAULT
status   {}                            everything the bridge publishes
"""

from __future__ import annotations

from typing import Any

from pydantic import Field, ValidationError

from clothrf_core.rig import Section
from clothrf_zenoh.faults import MalformedMessage

VERBS = ("arm", "renew", "release", "estop", "clear", "status")


class ArmRequest(Section):
    """Ask for the arms."""

    gid: str = Field(pattern="^[0-9a-f]{32}$")
    sequence: int = Field(ge=0, lt=2**63)
    stamp_ns: int = Field(ge=0, lt=2**63)
    lease_s: float = Field(ge=0.1, le=2.0)


class GrantRequest(Section):
    """Renew or release a grant."""

    gid: str = Field(pattern="^[0-9a-f]{32}$")
    epoch: int = Field(ge=0, lt=2**32)


class EstopRequest(Section):
    """Stop everything."""

    who: str = Field("somebody", max_length=80)


class Reply(Section):
    """What the bridge answers.

    Attributes:
        ok: it was done.
        reason: why not, "" if it was.
        state: the bridge's state afterwards.
        epoch: number of the last grant.
        posture: present output, rad, joint order; empty without a controller.
        status: the published counters, for `status` only.
    """

    ok: bool
    reason: str = ""
    state: str = ""
    epoch: int = 0
    posture: list[float] = []
    status: dict[str, Any] = {}


def read(model: type[Section], data: bytes) -> Any:
    """A request of type `model` from its JSON.

    Raises:
        MalformedMessage: not JSON or not that request; names the field.
    """
    try:
        return model.model_validate_json(data[:4096] or b"{}")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or model.__name__
        raise MalformedMessage(where, expected=first["msg"], found=repr(first["input"])[:80]) from (
            error
        )
