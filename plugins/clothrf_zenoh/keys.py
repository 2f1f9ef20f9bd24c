"""Where things are on the wire: rmw_zenoh key expressions, type hashes, graph tokens.

A ROS 2 topic is the key ``<domain>/<topic>/<pkg>::msg::dds_::<Type>_/<RIHS01 hash>``. A publisher
must use the exact hash; a subscriber may end in ``*`` to be independent of the distribution
(Humble writes ``TypeHashNotSupported``). Requests to the bridge are plain Zenoh queries under
``clothrf/<domain>/<namespace>/``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from clothrf_core.errors import ConfigError

NO_HASH = "TypeHashNotSupported"

# A sensible default QoS as rmw_zenoh writes it: reliable, volatile, keep last 10.
_QOS = "::,10:,:,:,,"
_NAME = re.compile(r"[a-zA-Z_][a-zA-Z0-9_]*(/[a-zA-Z_][a-zA-Z0-9_]*)*")


@dataclass(frozen=True, slots=True)
class MessageType:
    """A ROS 2 message type and the hash of its definition (REP 2016, RIHS01)."""

    name: str
    rihs01: str

    @property
    def dds(self) -> str:
        """As DDS and rmw_zenoh spell it: ``pkg::msg::dds_::Type_``."""
        package, kind, name = self.name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


JOINT_TRAJECTORY = MessageType(
    "trajectory_msgs/msg/JointTrajectory",
    "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
)
POSE_ARRAY = MessageType(
    "geometry_msgs/msg/PoseArray",
    "RIHS01_af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
)
JOINT_STATE = MessageType(
    "sensor_msgs/msg/JointState",
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
)
DIAGNOSTIC_ARRAY = MessageType(
    "diagnostic_msgs/msg/DiagnosticArray",
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
)


@dataclass(frozen=True, slots=True)
class Topic:
    """One ROS 2 topic in one domain."""

    domain: int
    name: str
    type: MessageType

    @property
    def key(self) -> str:
        """What a publisher puts to."""
        return f"{self.domain}/{self.name}/{self.type.dds}/{self.type.rihs01}"

    @property
    def any_distribution(self) -> str:
        """What a subscriber listens to: the same type whatever the hash."""
        return f"{self.domain}/{self.name}/{self.type.dds}/*"


@dataclass(frozen=True, slots=True)
class Keys:
    """All keys of one robot.

    Attributes:
        namespace: ROS namespace without the leading slash, for example ``yumi``.
        domain: ROS_DOMAIN_ID.
    """

    namespace: str
    domain: int = 0

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.namespace) or not 0 <= self.domain <= 232:
            raise ConfigError(
                "keys: expected a ROS name such as 'yumi' and a domain of 0 to 232, found "
                f"'{self.namespace}' and {self.domain}"
            )

    def _topic(self, name: str, kind: MessageType) -> Topic:
        return Topic(self.domain, f"{self.namespace}/{name}", kind)

    @property
    def joint_trajectory(self) -> Topic:
        """Joint commands, sender to bridge."""
        return self._topic("joint_trajectory", JOINT_TRAJECTORY)

    @property
    def grasp_targets(self) -> Topic:
        """Where the policy wants the grippers; to be looked at, the bridge does not act on it."""
        return self._topic("grasp_targets", POSE_ARRAY)

    @property
    def joint_states(self) -> Topic:
        """Measured joints, bridge to everybody."""
        return self._topic("joint_states", JOINT_STATE)

    @property
    def diagnostics(self) -> Topic:
        """The bridge's health."""
        return self._topic("diagnostics", DIAGNOSTIC_ARRAY)

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics, for recording."""
        return (self.joint_trajectory, self.grasp_targets, self.joint_states, self.diagnostics)

    def request(self, verb: str) -> str:
        """Key of the query `verb`: arm, renew, release, estop, clear or status."""
        return f"clothrf/{self.domain}/{self.namespace}/{verb}"

    @property
    def alive(self) -> str:
        """Liveliness token of a running bridge."""
        return f"clothrf/{self.domain}/{self.namespace}/alive"


def _mangled(name: str) -> str:
    return name.replace("/", "%")


def node_token(domain: int, session: str, node: str, node_id: int = 0) -> str:
    """Liveliness key that makes `node` visible in the ROS graph (`ros2 node list`)."""
    return f"@ros2_lv/{domain}/{session}/{node_id}/{node_id}/NN/%/%/{node}"


def topic_token(
    topic: Topic, session: str, node: str, *, entity: int, publishes: bool, node_id: int = 0
) -> str:
    """Liveliness key that makes a publisher or subscription visible (`ros2 topic list`)."""
    kind = "MP" if publishes else "MS"
    name = _mangled("/" + topic.name)
    return (
        f"@ros2_lv/{topic.domain}/{session}/{node_id}/{entity}/{kind}/%/%/{node}/{name}/"
        f"{topic.type.dds}/{topic.type.rihs01}/{_QOS}"
    )
