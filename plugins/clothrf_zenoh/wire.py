"""Zenoh on the bridge's side: what comes in, what goes out; no decision is made here.

Everything is polled from the loop's own thread out of bounded rings, so no Python callback ever
competes with it for the interpreter and no flood makes memory grow.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from clothrf_zenoh.attachment import Attachment
from clothrf_zenoh.keys import Keys, Topic, node_token, topic_token
from clothrf_zenoh.requests import VERBS, Reply

COMMANDS_KEPT = 64
REQUESTS_KEPT = 16


class Outlet:
    """One publisher: bytes with their attachment, counted from 1."""

    def __init__(
        self, session: zenoh.Session, topic: Topic, gid: bytes, *, urgent: bool = False
    ) -> None:
        priority = zenoh.Priority.REAL_TIME if urgent else zenoh.Priority.DATA_HIGH
        # Never BLOCK: a slow reader would hold the loop for seconds.
        self._publisher = session.declare_publisher(
            topic.key,
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority,
            express=True,
            reliability=zenoh.Reliability.RELIABLE,
        )
        self._gid = gid
        self.sequence = 0

    def put(self, payload: bytes, stamp_ns: int) -> None:
        """Send; never blocks."""
        self.sequence += 1
        attachment = Attachment(self.sequence, stamp_ns, self._gid).encode()
        self._publisher.put(payload, attachment=attachment)

    def undeclare(self) -> None:
        """Stop offering the topic."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


class BridgeWire:
    """The bridge's subscriptions, publishers and queryables on an open session.

    Args:
        session: open; closed by its owner.
        keys: where everything is.
        gid: 16-byte id of this bridge's publishers.
        max_bytes: longer commands are refused unread.
    """

    def __init__(
        self, session: zenoh.Session, keys: Keys, gid: bytes, *, max_bytes: int = 4096
    ) -> None:
        self._session = session
        self._keys = keys
        self._gid = gid
        self._max_bytes = max_bytes
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        session, keys, stack = self._session, self._keys, self._stack
        ring = zenoh.handlers.RingChannel
        self._commands = session.declare_subscriber(
            keys.joint_trajectory.any_distribution, ring(COMMANDS_KEPT)
        )
        stack.callback(self._commands.undeclare)
        self._stop = session.declare_subscriber(keys.request("estop"), ring(1))
        stack.callback(self._stop.undeclare)
        # One ring for all verbs: polling costs time in every tick.
        self._requests = session.declare_queryable(keys.request("*"), ring(REQUESTS_KEPT))
        stack.callback(self._requests.undeclare)
        self.state = Outlet(session, keys.joint_states, self._gid)
        self.health = Outlet(session, keys.diagnostics, self._gid)
        stack.callback(self.state.undeclare)
        stack.callback(self.health.undeclare)
        zid = str(session.info.zid())
        node = f"{keys.namespace.replace('/', '_')}_bridge"
        tokens = [keys.alive, node_token(keys.domain, zid, node)]
        for entity, topic in enumerate((keys.joint_states, keys.diagnostics), start=1):
            tokens.append(topic_token(topic, zid, node, entity=entity, publishes=True))
        command = keys.joint_trajectory
        tokens.append(topic_token(command, zid, node, entity=3, publishes=False))
        for key in tokens:
            token = session.liveliness().declare_token(key)
            stack.callback(token.undeclare)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def commands(self) -> Iterator[tuple[bytes | None, bytes]]:
        """(attachment, payload) of everything that has arrived, oldest first, at most a ringful."""
        for _ in range(COMMANDS_KEPT):
            sample = self._commands.try_recv()
            if sample is None:
                return
            attachment = sample.attachment
            payload = sample.payload
            yield (
                None if attachment is None else attachment.to_bytes(),
                payload.to_bytes() if len(payload) <= self._max_bytes else b"",
            )

    def stop_pressed(self) -> bool:
        """Something was put on the emergency-stop key."""
        return self._stop.try_recv() is not None

    def answer(self, handle: Callable[[str, bytes], Reply], *, limit: int = 4) -> None:
        """Let `handle` answer waiting requests, at most `limit`."""
        for _ in range(limit):
            query = self._requests.try_recv()
            if query is None:
                return
            with query:
                verb = str(query.key_expr).rpartition("/")[2]
                if verb not in VERBS:
                    continue
                payload = query.payload
                data = b"{}"
                if payload is not None and len(payload) <= self._max_bytes:
                    data = payload.to_bytes()
                reply = handle(verb, data)
                query.reply(self._keys.request(verb), reply.model_dump_json())
