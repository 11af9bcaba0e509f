"""The daemon's ZeroMQ sockets: a publisher and a command socket that never block the loop.

A client that does not receive in time loses messages. All of `Bus` is safe in the loop.
"""

from __future__ import annotations

import contextlib
import grp
import math
import os
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import msgpack
import zmq

from palmd.daemon.command_queue import PER_TICK, CommandQueue, Key
from palmd.daemon.commands import COMMANDS, CommandError, Reply, Request, parse, reply_fields
from palmd.daemon.ownership import NOBODY_KEY
from palmd.daemon.packing import FieldsPacker
from palmd.daemon.zap_auth import ZapAuthenticator
from palmd.keys import Member, ServerKeys
from palmd.messages import Fields, stamp
from palmd.quantities import Topic

HIGH_WATER = 100
PUBLISH_HIGH_WATER = 10_000
"""Messages queued for a slow subscriber: about 20 s of all topics, 10 MB."""
LINGER_MS = 100
BACKLOG_PER_PUBLISH = 8
"""Buffered messages sent with each new one: a backlog of half a second is sent within about ten ticks."""
SUBSCRIBE_GRACE_S = 0.1
"""Buffering after the awaited command: the sender's subscription, on another connection, may arrive later."""
MESSAGES_PER_TICK = 128
"""Messages read from the command socket in a tick. More than the number of clients that can connect, send and
disconnect in a tick: each closed connection keeps some 30 kB in ZeroMQ until its message is read. Reading that many
takes about 1.5 ms; on two cores up to 90 arrive in a tick."""
MAX_FRAMES = 4
"""Frames of a message that are examined: a command has its sender's identity, at most one empty frame, and the payload.
"""
FRAMES_PER_TICK = MAX_FRAMES * MESSAGES_PER_TICK
MESSAGE_BYTES_MAX = 1 << 20  # ZeroMQ itself disconnects a client that sends more


class BusError(Exception):
    """A socket that cannot be bound; states which, why, and what to do."""


@dataclass(slots=True)
class BusCounters:
    """Counts since the start; `replies_lost` are replies whose client had disconnected.

    `forbidden`: commands from clients that may only watch. `crowded`: commands rejected because too many others waited.
    `turned_away`: connections with unlisted keys. `unproven`: connections without a key or with another server's key.
    """

    published: int = 0
    commands: int = 0
    malformed: int = 0
    forbidden: int = 0
    crowded: int = 0
    turned_away: int = 0
    unproven: int = 0
    replies_lost: int = 0


class Bus:
    """Both sockets, bound by the constructor; raises BusError if an address cannot be bound."""

    def __init__(
        self,
        publish: str,
        command: str,
        keys: ServerKeys | None = None,
        context: zmq.Context[zmq.Socket[bytes]] | None = None,
        frames: int = 3,
        group: str | None = None,
    ) -> None:
        """`publish` and `command` are ZeroMQ addresses; with `keys` only listed clients can connect, encrypted.

        A message has `frames` frames: topic, map and time (3), or the first two of these. Local sockets are accessible
        to this user only, or also to the members of `group`. `close` destroys the `context`.
        """
        self.counters = BusCounters()
        self._seq: dict[str, int] = {}
        self._pack = FieldsPacker()
        self._outbox: deque[tuple[bytes, ...]] = deque()
        self._frames = frames
        self._awaited_command, self._t_buffer_end = "", -math.inf  # end of buffering: command, time (s)
        self._queue = CommandQueue()
        self._dropping = False  # whether the rest of an oversized message is being discarded
        self._frames_left = FRAMES_PER_TICK
        self._context = context or zmq.Context()
        self._group = group
        self._authenticator = None if keys is None else ZapAuthenticator(self._context, keys)
        self._sockets: list[zmq.Socket[bytes]] = []
        try:
            self._publisher = self._bind(zmq.PUB, publish, "bus.publish")
            self._commands = self._bind(zmq.ROUTER, command, "bus.command")
        except BusError:
            self.close()
            raise
        if self._authenticator is not None:
            self._authenticator.begin()
        self._t_open = time.monotonic()

    def publish(self, topic: Topic, fields: Fields, t: float, timestamp: float) -> None:
        """Send, buffer (`buffer_until`) or drop one message; `t` is the tick's time, `timestamp` Unix time (s)."""
        seq = self._seq.get(topic.name, 0)
        self._seq[topic.name] = seq + 1
        payload = self._pack(stamp(fields, timestamp, t, seq))
        self._outbox.append((topic.frame, payload, b"%.6f" % timestamp)[: self._frames])
        self.counters.published += 1
        if t >= self._t_buffer_end:
            self._send_backlog(BACKLOG_PER_PUBLISH)

    def _send_backlog(self, most: int) -> None:
        for _ in range(min(most, len(self._outbox))):
            with contextlib.suppress(zmq.Again):
                self._publisher.send_multipart(self._outbox.popleft(), zmq.NOBLOCK)

    def receive(self, owner: Key = NOBODY_KEY) -> list[Request]:
        """The valid commands to execute in this tick while the client `owner` has control; rejects the others."""
        self._enqueue_received(owner)
        requests, refused = self._queue.take(owner) if len(self._queue) else ([], [])
        for request, reason in refused:
            self._reject_busy(request, reason)
        if self._awaited_command and any(request.name == self._awaited_command for request in requests):
            self._awaited_command = ""
            self._t_buffer_end = min(self._t_buffer_end, time.monotonic() + SUBSCRIBE_GRACE_S)
        return requests

    def _enqueue_received(self, owner: Key) -> None:
        """Queue the commands that have arrived.

        ZeroMQ serves clients in turn: a second message of one client in a tick means that every other client has been
        read. A client that floods the socket delays only itself. A stop is found in the tick in which it arrives,
        unless more than `MESSAGES_PER_TICK` clients send at once.
        """
        self._frames_left = FRAMES_PER_TICK
        served: set[tuple[bytes, ...]] = set()
        before = len(self._queue)
        for number in range(MESSAGES_PER_TICK):
            frames = self._receive_message()
            if frames is None:
                return
            self.counters.commands += 1
            route, payloads = _split_route([frame.bytes for frame in frames])
            request = self._authorised(route, payloads, frames[-1])
            refused = None if request is None else self._queue.add(request, owner)
            if refused is not None:
                self._reject_busy(*refused)
            if before + number >= PER_TICK and route in served:
                return
            served.add(route)

    def _authorised(self, route: tuple[bytes, ...], payloads: list[bytes], frame: zmq.Frame) -> Request | None:
        """The command in a message; answers invalid and forbidden ones and returns None for them."""
        try:
            if len(payloads) != 1:
                raise CommandError(f"expected one frame with a map {{id, cmd, args}}, got {len(payloads)}")
            request = parse(payloads[0], route)
        except CommandError as error:
            self.counters.malformed += 1
            self._send(route, reply_fields(error.id, str(error)))
            return None
        member = None if self._authenticator is None else self._authenticator.member(frame)
        if self._authenticator is None or (member is not None and member.role.covers(COMMANDS[request.name].role)):
            return replace(
                request, who=_sender_name(request, member, frame), member="" if member is None else member.name
            )
        self.counters.forbidden += 1
        self._send(route, reply_fields(request.id, f"{request.name} refused: your key may only watch"))
        return None

    def _reject_busy(self, request: Request, reason: str) -> None:
        self.counters.crowded += 1
        self._send(request.route or (), reply_fields(request.id, f"{request.name} refused: {reason}"))

    def _receive_message(self) -> list[zmq.Frame] | None:
        """The next message, truncated if oversized; None if there is none or the tick's limit is reached.

        The limit counts frames, because a client may put any number of them into one message; the rest of such a
        message is discarded in later ticks.
        """
        frames: list[zmq.Frame] = []
        while frames or self._frames_left > 0:
            try:
                frame = self._commands.recv(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return None
            self._frames_left -= 1
            dropped, more = self._dropping, frame.more
            if not dropped:
                frames.append(frame)
            self._dropping = more and (dropped or len(frames) == MAX_FRAMES)
            if not dropped and (self._dropping or not more):
                return frames
        return None

    def buffer_until(self, name: str, seconds: float, *, since_open: bool = False) -> None:
        """Buffer what is published until `SUBSCRIBE_GRACE_S` after a command `name` has arrived, for at most `seconds`.

        The time counts from now, or with `since_open` from when the addresses were bound. For a recorder, which must
        miss no message; the loop does not wait for it. Buffered messages are sent in their order, a few with each new
        one.
        """
        self._awaited_command = name
        self._t_buffer_end = (self._t_open if since_open else time.monotonic()) + seconds

    def reply(self, reply: Reply) -> None:
        """Answer a request; the answer is lost if the client has disconnected."""
        if reply.request.route is not None:
            self._send(reply.request.route, reply.fields())

    def fields(self) -> dict[str, int]:
        """The counters under their names in `palm/loop`."""
        if self._authenticator is not None:
            self.counters.turned_away = self._authenticator.turned_away
            self.counters.unproven = self._authenticator.unproven
        return {f"bus_{name}": count for name, count in asdict(self.counters).items()}

    def close(self) -> None:
        """Close the sockets; messages still queued have `LINGER_MS` to be sent, the rest is dropped."""
        self._send_backlog(len(self._outbox))
        for socket in self._sockets:
            socket.close()
        if self._authenticator is not None:
            self._authenticator.close()
        self._context.destroy()
        self._authenticator = None

    def _bind(self, kind: int, address: str, key: str) -> zmq.Socket[bytes]:
        socket = self._context.socket(kind)
        self._sockets.append(socket)
        if self._authenticator is not None:
            self._authenticator.guard(socket)
        socket.setsockopt(zmq.LINGER, LINGER_MS if kind == zmq.PUB else 0)
        socket.setsockopt(zmq.SNDHWM, PUBLISH_HIGH_WATER if kind == zmq.PUB else HIGH_WATER)
        socket.setsockopt(zmq.RCVHWM, HIGH_WATER)
        socket.setsockopt(zmq.MAXMSGSIZE, MESSAGE_BYTES_MAX)
        try:
            with _permissions(address, self._group):
                socket.bind(address)
        except zmq.ZMQError as error:
            if error.errno == zmq.EADDRINUSE:
                raise BusError(
                    f"{key}: {address} is in use, perhaps by another palmd: stop that one, or configure another address"
                ) from None
            raise BusError(f"{key}: {address} cannot be bound: {error.strerror}") from None
        return socket

    def _send(self, route: tuple[bytes, ...], fields: Fields) -> None:
        try:
            self._commands.send_multipart((*route, msgpack.packb(fields)), zmq.NOBLOCK)
        except zmq.ZMQError:
            self.counters.replies_lost += 1


@contextlib.contextmanager
def _permissions(address: str, group: str | None) -> Iterator[None]:
    """Restrict a local socket bound inside the context to this user, and to the members of `group` if given.

    Raises BusError for a group to which it cannot be assigned.
    """
    if not address.startswith("ipc://"):
        yield
        return
    before = os.umask(0o177)  # until the group is right
    try:
        yield
    finally:
        os.umask(before)
    if group is None:
        return
    path = Path(address.removeprefix("ipc://"))
    try:
        number = grp.getgrnam(group).gr_gid
        if path.stat().st_gid != number:  # if already correct, no permission to change it is needed
            os.chown(path, -1, number)
        path.chmod(0o660)
    except KeyError:
        raise BusError(f"bus.group: there is no group {group}") from None
    except OSError as error:
        raise BusError(f"bus.group: {path} cannot be given to the group {group}: {error.strerror}") from None


def _sender_name(request: Request, member: Member | None, frame: zmq.Frame) -> str:
    """The sender of a command: the proven name of its key, and the unproven name that the program gives itself."""
    own_name = request.who or request.client
    if member is not None:
        return f"{member.name}, by {own_name}" if own_name else member.name
    if own_name:
        return own_name
    try:
        return f"a program at {frame.get('Peer-Address')}"
    except zmq.ZMQError:
        return "a program"


def _split_route(frames: list[bytes]) -> tuple[tuple[bytes, ...], list[bytes]]:
    """The reply route and the payload frames: a REQ client puts an empty frame first, a DEALER need not."""
    identity, *rest = frames
    if len(rest) > 1 and rest[0] == b"":
        return (identity, b""), rest[1:]
    return (identity,), rest
