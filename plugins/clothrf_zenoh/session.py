"""How a Zenoh session is opened: only where the config says, only with whom it says.

Zenoh's defaults find peers by multicast, gossip about them and listen on every interface; here all
three are off, and a side that names no address to listen on listens nowhere.
"""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zenoh

from clothrf_core.errors import ConfigError
from clothrf_zenoh.config import Role, ZenohSection
from clothrf_zenoh.faults import BridgeUnreachable, UnsafeExposure
from clothrf_zenoh.keys import Keys

Strings = tuple[str, ...]


def keys_of(section: ZenohSection) -> Keys:
    """The keys that this session speaks on."""
    return Keys(section.namespace, section.domain)


def options_of(section: ZenohSection, folder: Path) -> dict[str, Any]:
    """Zenoh configuration, key -> value, as plain data.

    Raises:
        ConfigError: no endpoint, an endpoint that is not one, or a file that cannot be read.
    """
    for endpoint in [*section.listen, *section.connect]:
        host_of(endpoint)
    if not section.listen and not section.connect:
        raise ConfigError('zenoh: expected listen = ["tcp/127.0.0.1:7447"] or connect, found none')
    first, longest = section.retry_s
    retry = {"period_init_ms": int(1e3 * first), "period_max_ms": int(1e3 * longest)}
    options: dict[str, Any] = {
        # The side that listens is the hub of a star: a recorder sees what a sender sends.
        "mode": "router" if section.listen else "client",
        "listen/endpoints": section.listen,
        "listen/exit_on_failure": True,
        "connect/endpoints": section.connect,
        "connect/timeout_ms": -1 if section.listen else int(1e3 * section.connect_timeout_s),
        "connect/exit_on_failure": not section.listen,
        "connect/retry": retry,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": int(1e3 * section.lease_s),
        "transport/link/rx/max_message_size": section.max_message_bytes,
        "transport/shared_memory/enabled": False,
        "adminspace/enabled": False,
    }
    if section.tls is not None:
        certificate, key = _file(folder, section.tls.certificate), _file(folder, section.tls.key)
        options["transport/link/tls"] = {
            "root_ca_certificate": _file(folder, section.tls.ca),
            "enable_mtls": True,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
            "verify_name_on_connect": section.tls.verify_name,
        }
    if section.user is not None:
        password = Path(_file(folder, section.user.password_file)).read_text().splitlines()
        if not password or not password[0]:
            raise ConfigError("zenoh.user.password_file: expected a password in its first line")
        auth: dict[str, Any] = {"user": section.user.name, "password": password[0]}
        if section.user.dictionary is not None:
            auth["dictionary_file"] = _file(folder, section.user.dictionary)
        options["transport/auth/usrpwd"] = auth
    if section.access:
        options["access_control"] = access_control(section)
    return options


def access_control(section: ZenohSection) -> dict[str, Any]:
    """Zenoh's rules for the config's roles; what no rule allows is refused."""
    rules = [
        {
            "id": f"{role}-{what}",
            "permission": "allow",
            "flows": list(flows),
            "messages": list(messages),
            "key_exprs": list(expressions),
        }
        for role in ("controller", "operator", "viewer")
        for what, flows, messages, expressions in _rules(role, keys_of(section))
    ]
    subjects, policies = [], []
    for i, entry in enumerate(section.access):
        subject: dict[str, Any] = {"id": f"{entry.role}-{i}"}
        if entry.users:
            subject["usernames"] = entry.users
        if entry.certificates:
            subject["cert_common_names"] = entry.certificates
        subjects.append(subject)
        mine = [rule["id"] for rule in rules if str(rule["id"]).startswith(f"{entry.role}-")]
        policies.append({"rules": mine, "subjects": [subject["id"]]})
    used = {rule for policy in policies for rule in policy["rules"]}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for rule in rules if rule["id"] in used],
        "subjects": subjects,
        "policies": policies,
    }


def _rules(role: Role, keys: Keys) -> list[tuple[str, Strings, Strings, Strings]]:
    """(name, flows, messages, key expressions) of a role, as the bridge sees its peer."""
    both, into, out = ("ingress", "egress"), ("ingress",), ("egress",)
    state = (
        keys.joint_states.any_distribution,
        keys.diagnostics.any_distribution,
        keys.joint_trajectory.any_distribution,
        keys.grasp_targets.any_distribution,
        keys.alive,
        "@ros2_lv/**",
    )
    verbs: Mapping[Role, tuple[str, ...]] = {
        "viewer": ("status",),
        "operator": ("status", "estop", "clear"),
        "controller": ("status", "estop", "clear", "arm", "renew", "release"),
    }
    requests = tuple(keys.request(verb) for verb in verbs[role])
    rules: list[tuple[str, Strings, Strings, Strings]] = [
        ("subscribe", into, ("declare_subscriber", "declare_liveliness_subscriber"), state),
        ("receive", out, ("put", "liveliness_token", "liveliness_query"), state),
        ("ask-liveliness", into, ("liveliness_query",), state),
        ("ask", into, ("query",), requests),
        ("answer", out, ("reply",), requests),
        ("offer", out, ("declare_queryable",), (keys.request("*"),)),
    ]
    if role == "controller":
        commands = (keys.joint_trajectory.key, keys.grasp_targets.key)
        rules.append(("command", into, ("put",), commands))
        rules.append(("listen", out, ("declare_subscriber",), commands_any(keys)))
        rules.append(("graph", both, ("liveliness_token",), ("@ros2_lv/**",)))
    if role != "viewer":
        rules.append(("stop", into, ("put",), (keys.request("estop"),)))
    return rules


def commands_any(keys: Keys) -> tuple[str, ...]:
    """What the bridge subscribes to."""
    return (keys.joint_trajectory.any_distribution, keys.grasp_targets.any_distribution)


def exposed(section: ZenohSection) -> list[str]:
    """Endpoints that reach beyond this machine."""
    ends = [*section.listen, *section.connect]
    return [end for end in ends if not _local(host_of(end))]


def require_protection(section: ZenohSection) -> None:
    """Refuse an address beyond this machine without protection.

    Raises:
        UnsafeExposure: naming the endpoints and the remedies.
    """
    ends = exposed(section)
    protected = section.tls is not None or section.user is not None
    if ends and not protected and not section.insecure:
        raise UnsafeExposure(
            f"zenoh: expected endpoints on this machine or some protection, found {ends} with "
            "neither [zenoh.tls] nor [zenoh.user]; add one of them, listen on 127.0.0.1, or write "
            "insecure = true if everybody on that network may move the robot"
        )
    plain = [end for end in ends if not end.startswith(("tls/", "quic/"))]
    if plain and section.tls is not None and not section.insecure:
        raise UnsafeExposure(
            f"zenoh: [zenoh.tls] is given but {plain} are not encrypted; write tls/HOST:PORT"
        )


def open_session(section: ZenohSection, folder: Path) -> zenoh.Session:
    """A session as the config says.

    Raises:
        ConfigError: the config is wrong.
        UnsafeExposure: it would be open to strangers.
        BridgeUnreachable: the address cannot be listened on.
    """
    require_protection(section)
    config = zenoh.Config()
    options = options_of(section, folder)
    try:
        for key, value in options.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise ConfigError(f"zenoh: expected options that Zenoh knows, found {error}") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = str(error).partition(" at /")[0]
        if section.listen:
            text = f"zenoh: cannot listen on {section.listen}: {reason}"
        else:
            text = (
                f"zenoh: nobody to talk to at {section.connect}: {reason} Is `clothrf bridge` "
                "running there, and does it know this user or certificate?"
            )
        raise BridgeUnreachable(text) from error


def host_of(endpoint: str) -> str:
    """Host part of ``protocol/host:port``.

    Raises:
        ConfigError: it is not one.
    """
    protocol, slash, address = endpoint.partition("/")
    address = address.partition("#")[0].partition("?")[0]
    if protocol == "unixsock-stream" and address:
        return "localhost"
    host, colon, port = address.rpartition(":")
    if not (slash and colon and host and port.isdigit()) or int(port) > 65535:
        raise ConfigError(f"zenoh endpoint: expected 'tcp/127.0.0.1:7447', found '{endpoint}'")
    return host.strip("[]")


def _local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return host == "localhost"


def _file(folder: Path, path: Path) -> str:
    full = (folder / path).resolve()
    if not full.is_file():
        raise ConfigError(f"zenoh: expected a file at {full}, found none")
    return str(full)
