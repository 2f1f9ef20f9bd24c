"""Zenoh on the sender's side: ask the bridge for the arms, stream to it, hear how it is."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

import numpy as np
import zenoh

from clothrf_core.types import Float
from clothrf_zenoh.faults import BridgeRefused, BridgeUnreachable, MalformedMessage
from clothrf_zenoh.keys import Keys, node_token, topic_token
from clothrf_zenoh.messages import (
    JointState,
    JointTrajectoryCodec,
    PoseArray,
    decode_diagnostics,
    decode_joint_state,
    encode_pose_array,
    epoch_frame,
)
from clothrf_zenoh.pace import wall_ns
from clothrf_zenoh.requests import ArmRequest, EstopRequest, GrantRequest, Reply
from clothrf_zenoh.wire import Outlet


class BridgeClient:
    """One sender of joint commands.

    Args:
        session: open; closed by its owner.
        keys: where everything is.
        gid: 16 random bytes that name this sender.
        names: joint names, in the order of every vector.
        period_s: time between two commands; the point of a command is due after it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        gid: bytes,
        names: tuple[str, ...],
        *,
        period_s: float = 0.004,
    ) -> None:
        self._session = session
        self._keys = keys
        self._gid = gid
        self._codec = JointTrajectoryCodec(names)
        self._due_ns = int(1e9 * period_s)
        self._stack = ExitStack()
        self._renewal: Any = None
        self.epoch = 0
        self.held = False
        self.joints: JointState | None = None
        self.status: Mapping[str, str] = {}

    def __enter__(self) -> Self:
        session, keys = self._session, self._keys
        self._commands = Outlet(session, keys.joint_trajectory, self._gid, urgent=True)
        self._targets = Outlet(session, keys.grasp_targets, self._gid)
        ring = zenoh.handlers.RingChannel
        self._states = session.declare_subscriber(keys.joint_states.any_distribution, ring(1))
        self._health = session.declare_subscriber(keys.diagnostics.any_distribution, ring(16))
        for thing in (self._commands, self._targets, self._states, self._health):
            self._stack.callback(thing.undeclare)
        zid, node = str(session.info.zid()), "clothrf_sender"
        tokens = [node_token(keys.domain, zid, node)]
        for entity, topic in enumerate((keys.joint_trajectory, keys.grasp_targets), start=1):
            tokens.append(topic_token(topic, zid, node, entity=entity, publishes=True))
        for key in tokens:
            self._stack.callback(session.liveliness().declare_token(key).undeclare)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def wait_for_bridge(self, timeout_s: float) -> None:
        """Return when joint states arrive.

        Raises:
            BridgeUnreachable: none within `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        while self.joints is None or not self.status:
            self.poll()
            if time.monotonic() > deadline:
                raise BridgeUnreachable(
                    f"expected joint states on '{self._keys.joint_states.name}' within "
                    f"{timeout_s:g} s, found {'none' if self.joints is None else 'no health'}; "
                    "is `clothrf bridge` running at zenoh.connect, and its controller?"
                )
            time.sleep(0.01)

    def wait_for_link(self, timeout_s: float) -> None:
        """Return when a bridge is seen, with or without a controller.

        Raises:
            BridgeUnreachable: none within `timeout_s`.
        """
        deadline = time.monotonic() + timeout_s
        while not list(self._session.liveliness().get(self._keys.alive, timeout=0.5)):
            if time.monotonic() > deadline:
                raise BridgeUnreachable(
                    f"expected a bridge within {timeout_s:g} s, found none; is `clothrf bridge` "
                    "running at zenoh.connect?"
                )
            time.sleep(0.02)

    def poll(self) -> bool:
        """Take in what has arrived; True when there was a new joint state."""
        sample = self._states.try_recv()
        fresh = False
        if sample is not None:
            try:
                joints = decode_joint_state(sample.payload.to_bytes())
                fresh = joints.names == self._codec.names
                if fresh:
                    self.joints = joints
            except MalformedMessage:
                fresh = False
        self.hear()
        self._finish_renewal()
        return fresh

    def hear(self) -> list[tuple[int, Mapping[str, str]]]:
        """The bridge's news since the last call: (its wall clock in ns, status)."""
        news: list[tuple[int, Mapping[str, str]]] = []
        while (sample := self._health.try_recv()) is not None:
            try:
                message = decode_diagnostics(sample.payload.to_bytes())
            except MalformedMessage:
                continue
            if message.statuses:
                news.append((message.stamp_ns, dict(message.statuses[0].values)))
                self._heard(news[-1][1])
        return news

    def _heard(self, status: Mapping[str, str]) -> None:
        self.status = status
        # Older news than our grant say nothing about it.
        if self.held and status.get("epoch") == str(self.epoch):
            self.held = status.get("state") in ("ARMED", "RUNNING")

    def arm(self, lease_s: float, timeout_s: float = 1.0) -> Float:
        """Ask for the arms; (J,) the posture to begin at.

        Raises:
            BridgeRefused: not now; says why.
            BridgeUnreachable: no answer.
        """
        wish = ArmRequest(
            gid=self._gid.hex(),
            sequence=self._commands.sequence,
            stamp_ns=wall_ns(),
            lease_s=lease_s,
        )
        reply = self.ask("arm", wish.model_dump_json(), timeout_s)
        self.epoch, self.held = reply.epoch, True
        return np.array(reply.posture, np.float64)

    def renew(self) -> None:
        """Ask to keep the lease; the answer is taken in by `poll`, nothing waits."""
        self._finish_renewal()
        if self._renewal is None and self.held:
            grant = GrantRequest(gid=self._gid.hex(), epoch=self.epoch).model_dump_json()
            self._renewal = self._session.get(
                self._keys.request("renew"),
                zenoh.handlers.RingChannel(1),
                payload=grant,
                timeout=0.25,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

    def _finish_renewal(self) -> None:
        if self._renewal is None:
            return
        try:
            answer = self._renewal.try_recv()
        except zenoh.ZError:  # the query has ended without an answer
            self._renewal = None
            return
        if answer is not None:
            self._renewal = None
            if answer.ok is not None:
                reply = Reply.model_validate_json(answer.ok.payload.to_bytes())
                if not reply.ok and reply.epoch == self.epoch:
                    self.held = False

    def send(self, q: Float, qd: Float) -> None:
        """One joint command; never blocks."""
        stamp = wall_ns()
        frame = epoch_frame(self.epoch)
        self._commands.put(self._codec.encode(stamp, frame, q, qd, self._due_ns), stamp)

    def send_targets(self, positions: Float) -> None:
        """Say where the grippers are wanted; for people and recordings."""
        stamp = wall_ns()
        upright = np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))
        message = PoseArray(stamp, "world", positions, upright)
        self._targets.put(encode_pose_array(message), stamp)

    def release(self, timeout_s: float = 1.0) -> None:
        """Give the arms back, if they are ours.

        Raises:
            BridgeRefused: they are not.
            BridgeUnreachable: no answer.
        """
        if self.held:
            self.held = False
            grant = GrantRequest(gid=self._gid.hex(), epoch=self.epoch)
            self.ask("release", grant.model_dump_json(), timeout_s)

    def emergency_stop(self, who: str, timeout_s: float = 1.0) -> Reply:
        """Stop the arms whoever holds them; returns when the bridge has acknowledged it.

        Raises:
            BridgeUnreachable: no answer.
        """
        return self.ask("estop", EstopRequest(who=who[:80]).model_dump_json(), timeout_s)

    def ask(self, verb: str, payload: str = "{}", timeout_s: float = 1.0) -> Reply:
        """Any request and its answer.

        Raises:
            BridgeRefused: answered with a refusal.
            BridgeUnreachable: no answer.
        """
        replies = self._session.get(self._keys.request(verb), payload=payload, timeout=timeout_s)
        for answer in replies:
            if answer.ok is not None:
                reply = Reply.model_validate_json(answer.ok.payload.to_bytes())
                if not reply.ok:
                    raise BridgeRefused(f"the bridge refused '{verb}': {reply.reason}")
                return reply
        raise BridgeUnreachable(
            f"expected an answer to '{verb}' within {timeout_s:g} s, found none; is "
            "`clothrf bridge` running, and may this user ask it?"
        )
