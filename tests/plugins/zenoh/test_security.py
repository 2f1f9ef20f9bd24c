"""Who may connect, who may look, who may command: with a real bridge and real certificates."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import time

import numpy as np
import pytest
from clothrf_zenoh.client import BridgeClient
from clothrf_zenoh.config import TlsSection, UserSection, ZenohSection
from clothrf_zenoh.faults import BridgeUnreachable, UnsafeExposure
from clothrf_zenoh.process import BridgeProcess
from clothrf_zenoh.session import (
    exposed,
    keys_of,
    open_session,
    options_of,
    require_protection,
)

from clothrf_core.errors import ConfigError
from clothrf_core.testing.arms import CraneArms, crane_registry

from .processes import bridge_tables, free_port, until

NAMES = CraneArms().joint_names


@contextlib.contextmanager
def visitor(section, folder):
    with (
        open_session(section, folder) as session,
        BridgeClient(session, keys_of(section), bytes(16), NAMES) as client,
    ):
        yield client


def sees_state(client, timeout_s=3.0):
    deadline = time.monotonic() + timeout_s
    while client.joints is None and time.monotonic() < deadline:
        client.poll()
        time.sleep(0.01)
    return client.joints is not None


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    """A bridge with passwords: boss commands, watch stops and clears, guest looks."""
    folder = tmp_path_factory.mktemp("users")
    names = ("boss", "watch", "guest")
    for name in names:
        (folder / name).write_text(f"{name}-password\n")
    (folder / "wrong").write_text("guess\n")
    (folder / "users").write_text("".join(f"{name}:{name}-password\n" for name in names))
    port = free_port()
    tables = bridge_tables(port)
    tables["zenoh"] |= {
        "user": {"name": "boss", "password_file": "boss", "dictionary": "users"},
        "access": [
            {"role": "controller", "users": ["boss"]},
            {"role": "operator", "users": ["watch"]},
            {"role": "viewer", "users": ["guest"]},
        ],
    }

    def section(name, file):
        return ZenohSection(
            connect=[f"tcp/127.0.0.1:{port}"], user=UserSection(name=name, password_file=file)
        )

    with BridgeProcess(tables, folder=folder, registry=crane_registry):
        yield folder, section


def test_a_controller_may_read_and_command(guarded):
    folder, section = guarded

    with visitor(section("boss", "boss"), folder) as client:
        assert sees_state(client)
        client.arm(0.3)
        client.send(np.zeros(14), np.zeros(14))
        until(
            lambda: client.poll() is None or client.status.get("state") == "RUNNING", what="RUNNING"
        )
        client.release()


def test_a_viewer_may_read_but_neither_arm_nor_stop_nor_command(guarded):
    folder, section = guarded

    with visitor(section("guest", "guest"), folder) as client:
        assert sees_state(client)
        may_not_ask(client, "arm", "renew", "release", "estop", "clear")
        commands_do_not_arrive(client)
        client._session.put(client._keys.request("estop"), b"")
        time.sleep(0.1)
        assert client.ask("status").state != "ESTOP"


def may_not_ask(client, *verbs):
    for verb in verbs:
        with pytest.raises(BridgeUnreachable, match="may this user ask it"):
            client.ask(verb, timeout_s=0.3)


def refusals(client):
    return {k: v for k, v in client.ask("status").status.items() if k.startswith("refused")}


def commands_do_not_arrive(client):
    """Not even to be refused: the bridge's counters do not move."""
    before = refusals(client)
    for _ in range(5):
        client.send(np.zeros(14), np.zeros(14))
    time.sleep(0.1)
    assert refusals(client) == before


def test_an_operator_may_read_stop_and_clear_but_neither_arm_nor_command(guarded):
    folder, section = guarded

    with visitor(section("watch", "watch"), folder) as client:
        assert sees_state(client)
        may_not_ask(client, "arm", "renew", "release")
        commands_do_not_arrive(client)
        assert client.emergency_stop("the operator").state == "ESTOP"
        until(lambda: client.poll() is None or client.status.get("state") == "ESTOP", what="ESTOP")
        client.ask("clear")
        client._session.put(client._keys.request("estop"), b"")
        until(lambda: client.poll() is None or client.status.get("state") == "ESTOP", what="ESTOP")
        assert client.ask("clear").state == "IDLE"


def test_an_operators_stop_takes_the_arms_from_a_controller(guarded):
    folder, section = guarded

    with (
        visitor(section("boss", "boss"), folder) as boss,
        visitor(section("watch", "watch"), folder) as watch,
    ):
        assert sees_state(boss)
        boss.arm(2.0)
        watch.wait_for_link(5.0)
        watch.emergency_stop("the operator")
        before = refusals(boss)
        boss.send(np.zeros(14), np.zeros(14))
        until(lambda: refusals(boss) != before, what="the refusal of a command after the stop")
        assert boss.ask("status").state == "ESTOP"
        watch.ask("clear")


@pytest.mark.parametrize("user", [UserSection(name="boss", password_file="wrong"), None])
def test_a_stranger_does_not_get_in(guarded, user):
    folder, section = guarded
    stranger = section("boss", "boss").model_copy(update={"user": user, "connect_timeout_s": 0.5})

    with pytest.raises(BridgeUnreachable, match="does it know this user"):
        open_session(stranger, folder)


def certificates(folder, *names):
    """An authority and one certificate a name, made on the spot."""

    def openssl(*words):
        subprocess.run(["openssl", *words], check=True, capture_output=True, cwd=folder)

    curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
    openssl(
        "req",
        "-x509",
        *curve,
        "-keyout",
        "ca.key",
        "-out",
        "ca.pem",
        "-days",
        "2",
        "-subj",
        "/CN=ca",
    )
    (folder / "ext").write_text(
        "subjectAltName=IP:127.0.0.1\nbasicConstraints=CA:FALSE\n"
        "extendedKeyUsage=serverAuth,clientAuth\n"
    )
    for name in names:
        openssl(
            "req", *curve, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}"
        )
        openssl(
            *("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key"),
            *("-CAcreateserial", "-out", f"{name}.pem", "-days", "2", "-extfile", "ext"),
        )


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
def test_with_mutual_tls_only_a_certificate_of_the_authority_gets_in(tmp_path):
    certificates(tmp_path, "bridge", "controller", "viewer")
    port = free_port()
    tables = bridge_tables(port)
    tables["zenoh"] = {
        "listen": [f"tls/127.0.0.1:{port}"],
        "tls": {"ca": "ca.pem", "certificate": "bridge.pem", "key": "bridge.key"},
        "access": [
            {"role": "controller", "certificates": ["controller"]},
            {"role": "viewer", "certificates": ["viewer"]},
        ],
    }

    def section(name):
        tls = TlsSection(ca="ca.pem", certificate=f"{name}.pem", key=f"{name}.key")
        return ZenohSection(connect=[f"tls/127.0.0.1:{port}"], tls=tls)

    plain = ZenohSection(connect=[f"tcp/127.0.0.1:{port}"], connect_timeout_s=0.5)
    with BridgeProcess(tables, folder=tmp_path, registry=crane_registry):
        with visitor(section("controller"), tmp_path) as client:
            assert sees_state(client)
            client.arm(0.3)
            client.release()
        with visitor(section("viewer"), tmp_path) as client:
            assert sees_state(client)
            with pytest.raises(BridgeUnreachable):
                client.ask("arm", timeout_s=0.5)
        with pytest.raises(BridgeUnreachable):
            open_session(plain, tmp_path)


# ---- before anything is opened ------------------------------------------------------------------


@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "tcp/localhost:7447", "udp/127.0.0.9:1"]
)
def test_an_address_of_this_machine_needs_no_protection(endpoint):
    require_protection(ZenohSection(listen=[endpoint]))


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.125.2:7447", "tcp/robot.local:7447"],
)
def test_an_address_beyond_this_machine_without_protection_is_refused(endpoint):
    with pytest.raises(UnsafeExposure, match="insecure = true"):
        require_protection(ZenohSection(listen=[endpoint]))


def test_insecure_can_be_written_down():
    require_protection(ZenohSection(listen=["tcp/0.0.0.0:7447"], insecure=True))


def test_access_rules_alone_are_no_protection():
    section = ZenohSection(
        listen=["tcp/0.0.0.0:7447"], access=[{"role": "viewer", "users": ["guest"]}]
    )

    with pytest.raises(UnsafeExposure):
        require_protection(section)


def test_certificates_on_an_unencrypted_address_are_refused():
    tls = TlsSection(ca="ca.pem", certificate="a.pem", key="a.key")

    with pytest.raises(UnsafeExposure, match="not encrypted"):
        require_protection(ZenohSection(listen=["tcp/10.0.0.1:7447"], tls=tls))


@pytest.mark.parametrize("endpoint", ["", "tcp", "tcp/", "tcp/host", "tcp/host:port", "host:7447"])
def test_an_endpoint_that_is_none_is_named(endpoint):
    with pytest.raises(ConfigError, match="expected 'tcp/127"):
        exposed(ZenohSection(listen=[endpoint]))


def test_nothing_is_found_by_itself(tmp_path):
    options = options_of(ZenohSection(connect=["tcp/127.0.0.1:1"]), tmp_path)

    assert options["scouting/multicast/enabled"] is False
    assert options["scouting/gossip/enabled"] is False
    assert options["listen/endpoints"] == []


def test_a_missing_certificate_file_is_named(tmp_path):
    tls = TlsSection(ca="ca.pem", certificate="a.pem", key="a.key")

    with pytest.raises(ConfigError, match=r"a\.pem, found none"):
        options_of(ZenohSection(listen=["tls/127.0.0.1:1"], tls=tls), tmp_path)
