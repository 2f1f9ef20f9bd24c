"""What a config may say about the stream and the bridge. Nothing heavy is imported here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from clothrf_core.rig import Section, Vector

Role = Literal["controller", "viewer", "operator"]


class TlsSection(Section):
    """Certificates (PEM files, paths relative to the config). Both sides show one: mutual TLS."""

    ca: Path = Field(description="certificate of the authority that signs everybody")
    certificate: Path = Field(description="this side's certificate")
    key: Path = Field(description="this side's private key; keep it out of version control")
    verify_name: bool = Field(True, description="the server's certificate must name its address")


class UserSection(Section):
    """User name and password (never both in one file with the rest)."""

    name: str = Field(min_length=1)
    password_file: Path = Field(description="file whose first line is the password")
    dictionary: Path | None = Field(
        None, description="bridge only: file of 'user:password' lines that may connect"
    )


class AccessSection(Section):
    """Who may do what on the bridge.

    controller: command and all requests; viewer: read state; operator: read state, stop, clear.
    """

    role: Role
    users: list[str] = Field([], description="user names that have this role")
    certificates: list[str] = Field([], description="certificate common names that have it")

    @model_validator(mode="after")
    def _somebody(self) -> Self:
        if not self.users and not self.certificates:
            raise ValueError("expected at least one of users, certificates")
        return self


Seconds = Annotated[float, Field(gt=0.0)]


class ZenohSection(Section):
    """The connection. Multicast scouting and gossip are off; nothing is found by itself."""

    listen: list[str] = Field([], description='endpoints to open, as "tcp/127.0.0.1:7447"')
    connect: list[str] = Field([], description="endpoints to connect to")
    namespace: str = Field("yumi", description="ROS namespace of all topics")
    domain: int = Field(0, ge=0, le=232, description="ROS_DOMAIN_ID")
    lease_s: Seconds = Field(0.5, description="a silent peer is dropped after this")
    retry_s: tuple[Seconds, Seconds] = Field((0.05, 0.2), description="first, longest wait")
    connect_timeout_s: Seconds = Field(5.0, description="wait for the other side when opening")
    max_message_bytes: int = Field(65536, ge=2048, description="larger messages are dropped")
    tls: TlsSection | None = None
    user: UserSection | None = None
    access: list[AccessSection] = Field([], description="empty: whoever connects may do everything")
    insecure: bool = Field(
        False, description="allow an address beyond this machine without TLS, password or access"
    )


class LimitsSection(Section):
    """What the bridge lets pass, beside the arm's own joint limits."""

    tcp_speed: float = Field(0.25, gt=0.0, le=1.5, description="of each gripper, m/s: stop above")
    tcp_speed_hard: float = Field(0.5, gt=0.0, le=1.5, description="never sent above, m/s")
    box_low: Vector = Field([0.1, -0.65, 0.0], description="grippers' box, world, m")
    box_high: Vector = Field([0.8, 0.65, 0.85], description="opposite corner, m")
    clearance: float = Field(0.010, ge=0.0, description="of all pairs, m: never sent below")
    clearance_ahead: float = Field(0.015, ge=0.0, description="where a stop would end, m")
    watchdog_s: Seconds = Field(0.1, description="silence that stops the arms")
    max_age_s: Seconds = Field(0.1, description="oldest command by its stamp")
    max_future_s: Seconds = Field(0.02, description="farthest stamp ahead")
    max_gap_s: Seconds = Field(
        0.1, description="pause of the bridge's own loop that stops the arms"
    )
    start_joint: float = Field(0.087, gt=0.0, description="first command within this, rad")
    start_tcp: float = Field(0.02, gt=0.0, description="and within this at the grippers, m")
    following: float = Field(0.35, gt=0.0, description="sent - measured, rad: stop above")


class BridgeConfig(Section):
    """A bridge file: `clothrf bridge FILE`."""

    kind: Literal["bridge"] = "bridge"
    rate_hz: float = Field(250.0, gt=0.0, le=1000.0, description="ticks a second")
    state_rate_hz: float = Field(50.0, gt=0.0, description="joint states published a second")
    diagnostics_rate_hz: float = Field(2.0, gt=0.0, description="health published a second")
    realtime_priority: int = Field(20, ge=0, le=50, description="SCHED_FIFO if permitted; 0: off")
    cpu: int | None = Field(None, ge=0, description="core to run on; none: any")
    rig: Path | None = Field(None, description="rig file: where table and grasped corners are")
    arm: dict[str, Any] = Field(description='arm model: plugin = "yumi" and its options')
    end: dict[str, Any] = Field(description='where the stream ends: plugin = "sim" or "egm"')
    zenoh: ZenohSection
    limits: LimitsSection = LimitsSection()


class YumiZenohConfig(Section):
    """`[robot] plugin = "yumi_zenoh"`: grasp targets to a joint stream to a bridge."""

    arm: dict[str, Any] = Field(
        default_factory=lambda: {"plugin": "yumi"}, description="the same arm model as the bridge's"
    )
    zenoh: ZenohSection = ZenohSection(connect=["tcp/127.0.0.1:7447"])
    rate_hz: float = Field(250.0, gt=0.0, le=1000.0, description="joint commands a second")
    tcp_speed: float = Field(0.2, gt=0.0, le=1.5, description="of the moving set-point, m/s")
    max_step: float = Field(0.3, gt=0.0, description="targets farther from the arms are refused, m")
    lease_s: float = Field(0.3, ge=0.1, le=2.0, description="the bridge stops if not renewed")
    deadman_s: Seconds = Field(1.0, description="no command for so long: the lease is let go")
    state_timeout_s: Seconds = Field(5.0, description="wait for joint states on entering")
    realtime_priority: int = Field(20, ge=0, le=50, description="SCHED_FIFO if permitted; 0: off")
    bridge: Path | None = Field(
        None, description="bridge file to start as well, for rehearsals on one machine"
    )
    simulate_controller: bool = Field(
        True, description="with `bridge`: start `clothrf egm-sim` too if it ends in EGM on loopback"
    )
    record: Path | None = Field(None, description="new MCAP file of everything on the wire")
