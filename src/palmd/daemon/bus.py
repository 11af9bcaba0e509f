"""The daemon on ZeroMQ: a publisher and a command socket that never block the loop.

Who does not listen in time loses messages, never the loop's time. All of `Bus` is safe in the loop.
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
PUBLISHED_HIGH_WATER = 10_000
"""Messages kept for a subscriber that does not take them: some 20 s of all topics, which is 10 MB."""
LAST_WORDS_MS = 100
SENT_AT_ONCE = 8
"""Messages with each that is published, of those that were kept: half a second of them takes some ten ticks."""
CAUGHT_UP_S = 0.1
"""After the awaited command, in which its sender's subscription comes too: it has a connection of its own."""
TAKEN_PER_TICK = 128
"""Messages taken off the socket: more than clients can connect, ask and go in a tick, for each of those that have gone
leaves some 30 kB in ZeroMQ until its message is taken. So many take some 1.5 ms; two cores see up to 90 come."""
FRAMES_MOST = 4
"""Of a message that are looked at: a command has its sender's identity, at most one empty frame, and itself."""
FRAMES_PER_TICK = FRAMES_MOST * TAKEN_PER_TICK
MESSAGE_BYTES_MAX = 1 << 20  # ZeroMQ itself turns away a client that sends more


class BusError(Exception):
    """A socket that cannot be had; says which, why, and what to do."""


@dataclass(slots=True)
class BusCounters:
    """What has passed on the bus since the start, or is held back; `replies_lost` found nobody to take them.

    `forbidden` commands came from clients that may only watch, `crowded` ones while too many others waited,
    `turned_away` connections with keys that nobody knows, `unproven` ones with no key, or with another server's.
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
    """Both sockets, bound from the beginning; raises BusError when an address cannot be had."""

    def __init__(
        self,
        publish: str,
        command: str,
        keys: ServerKeys | None = None,
        context: zmq.Context[zmq.Socket[bytes]] | None = None,
        frames: int = 3,
        group: str | None = None,
    ) -> None:
        """`publish` and `command` are ZeroMQ addresses; with `keys` only who is listed there comes in, encrypted.

        A message has so many `frames`: topic, map and time, or the first two of these. Local sockets are for this user
        alone, or also for the members of `group`. The sockets are the `context`'s, which `close` ends.
        """
        self.counters = BusCounters()
        self._seq: dict[str, int] = {}
        self._pack = FieldsPacker()
        self._outbox: deque[tuple[bytes, ...]] = deque()
        self._frames = frames
        self._awaited, self._t_held = "", -math.inf  # by which command, and until when (s) all in it is kept
        self._queue = CommandQueue()
        self._dropping = False  # the rest of a message that is far too long
        self._frames_left = FRAMES_PER_TICK
        self._context = context or zmq.Context()
        self._group = group
        self._door = None if keys is None else ZapAuthenticator(self._context, keys)
        self._sockets: list[zmq.Socket[bytes]] = []
        try:
            self._publisher = self._bound(zmq.PUB, publish, "bus.publish")
            self._commands = self._bound(zmq.ROUTER, command, "bus.command")
        except BusError:
            self.close()
            raise
        if self._door is not None:
            self._door.begin()
        self._t_open = time.monotonic()

    def publish(self, topic: Topic, fields: Fields, t: float, timestamp: float) -> None:
        """Send one message, or drop it, or keep it (`hold_back`); `t` is the tick's time, `timestamp` Unix time (s)."""
        seq = self._seq.get(topic.name, 0)
        self._seq[topic.name] = seq + 1
        payload = self._pack(stamp(fields, timestamp, t, seq))
        self._outbox.append((topic.frame, payload, b"%.6f" % timestamp)[: self._frames])
        self.counters.published += 1
        if t >= self._t_held:
            self._let_out(SENT_AT_ONCE)

    def _let_out(self, most: int) -> None:
        for _ in range(min(most, len(self._outbox))):
            with contextlib.suppress(zmq.Again):
                self._publisher.send_multipart(self._outbox.popleft(), zmq.NOBLOCK)

    def receive(self, owner: Key = NOBODY_KEY) -> list[Request]:
        """The valid commands whose turn it is while the client `owner` has control; the rest is answered here."""
        self._take_in(owner)
        requests, refused = self._queue.take(owner) if len(self._queue) else ([], [])
        for request, why in refused:
            self._crowded(request, why)
        if self._awaited and any(request.name == self._awaited for request in requests):
            self._awaited, self._t_held = "", min(self._t_held, time.monotonic() + CAUGHT_UP_S)
        return requests

    def _take_in(self, owner: Key) -> None:
        """Have what has come wait for its turn.

        ZeroMQ gives each client its turn, so all others have had theirs when somebody comes a second time in a tick:
        who sends without end has to wait, and nobody else has. A stop is found in the tick in which it has come, unless
        more clients than `TAKEN_PER_TICK` send at once.
        """
        self._frames_left = FRAMES_PER_TICK
        heard: set[tuple[bytes, ...]] = set()
        before = len(self._queue)
        for number in range(TAKEN_PER_TICK):
            frames = self._taken()
            if frames is None:
                return
            self.counters.commands += 1
            route, payloads = _opened([frame.bytes for frame in frames])
            request = self._allowed(route, payloads, frames[-1])
            refused = None if request is None else self._queue.add(request, owner)
            if refused is not None:
                self._crowded(*refused)
            if before + number >= PER_TICK and route in heard:
                return
            heard.add(route)

    def _allowed(self, route: tuple[bytes, ...], payloads: list[bytes], frame: zmq.Frame) -> Request | None:
        """The command in a message; what is none, or is not for its sender to give, is answered."""
        try:
            if len(payloads) != 1:
                raise CommandError(f"expected one frame with a map {{id, cmd, args}}, got {len(payloads)}")
            request = parse(payloads[0], route)
        except CommandError as error:
            self.counters.malformed += 1
            self._send(route, reply_fields(error.id, str(error)))
            return None
        member = None if self._door is None else self._door.member(frame)
        if self._door is None or (member is not None and member.role.covers(COMMANDS[request.name].role)):
            return replace(request, who=_who(request, member, frame), member="" if member is None else member.name)
        self.counters.forbidden += 1
        self._send(route, reply_fields(request.id, f"{request.name} refused: your key may only watch"))
        return None

    def _crowded(self, request: Request, why: str) -> None:
        self.counters.crowded += 1
        self._send(request.route or (), reply_fields(request.id, f"{request.name} refused: {why}"))

    def _taken(self) -> list[zmq.Frame] | None:
        """The next message that has come, cut off where it is far too long; None when there is no more for this tick.

        What a tick reads is bounded by frames, for a client may put any number of them into one message: the rest of it
        is dropped in the ticks to come.
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
            self._dropping = more and (dropped or len(frames) == FRAMES_MOST)
            if not dropped and (self._dropping or not more):
                return frames
        return None

    def hold_back(self, name: str, seconds: float, *, since_open: bool = False) -> None:
        """Keep what is published, up to `CAUGHT_UP_S` after a command of that name has come, at most so long.

        So long from now on, or `since_open`: from when the addresses could be found. For a recorder, which is to miss
        nothing: the loop need not wait for it. What was kept leaves in its order, a few messages with each new one.
        """
        self._awaited = name
        self._t_held = (self._t_open if since_open else time.monotonic()) + seconds

    def reply(self, reply: Reply) -> None:
        """Answer a request; lost when the client has gone."""
        if reply.request.route is not None:
            self._send(reply.request.route, reply.fields())

    def fields(self) -> dict[str, int]:
        """The counters by the names of `palm/loop`."""
        if self._door is not None:
            self.counters.turned_away, self.counters.unproven = self._door.turned_away, self._door.unproven
        return {f"bus_{name}": count for name, count in asdict(self.counters).items()}

    def close(self) -> None:
        """Let go of the addresses; what was published last has `LAST_WORDS_MS` to leave, the rest is dropped."""
        self._let_out(len(self._outbox))
        for socket in self._sockets:
            socket.close()
        if self._door is not None:
            self._door.close()
        self._context.destroy()
        self._door = None

    def _bound(self, kind: int, address: str, key: str) -> zmq.Socket[bytes]:
        socket = self._context.socket(kind)
        self._sockets.append(socket)
        if self._door is not None:
            self._door.guard(socket)
        socket.setsockopt(zmq.LINGER, LAST_WORDS_MS if kind == zmq.PUB else 0)
        socket.setsockopt(zmq.SNDHWM, PUBLISHED_HIGH_WATER if kind == zmq.PUB else HIGH_WATER)
        socket.setsockopt(zmq.RCVHWM, HIGH_WATER)
        socket.setsockopt(zmq.MAXMSGSIZE, MESSAGE_BYTES_MAX)
        try:
            with _permissions(address, self._group):
                socket.bind(address)
        except _GroupError as error:
            raise BusError(f"bus.group: {error}") from None
        except zmq.ZMQError as error:
            if error.errno == zmq.EADDRINUSE:
                raise BusError(
                    f"{key}: {address} is in use, perhaps by another palmd: end it, or configure another address"
                ) from None
            raise BusError(f"{key}: {address} cannot be bound: {error.strerror}") from None
        return socket

    def _send(self, route: tuple[bytes, ...], fields: Fields) -> None:
        try:
            self._commands.send_multipart((*route, msgpack.packb(fields)), zmq.NOBLOCK)
        except zmq.ZMQError:
            self.counters.replies_lost += 1


class _GroupError(Exception):
    """A group that local sockets cannot be given to."""


@contextlib.contextmanager
def _permissions(address: str, group: str | None) -> Iterator[None]:
    """A local socket that is bound meanwhile is for this user, and for the members of the group if one is given."""
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
        if path.stat().st_gid != number:  # where it is the right one the service need not be allowed to change it
            os.chown(path, -1, number)
        path.chmod(0o660)
    except KeyError:
        raise _GroupError(f"there is no group {group}") from None
    except OSError as error:
        raise _GroupError(f"{path} cannot be given to the group {group}: {error.strerror}") from None


def _who(request: Request, member: Member | None, frame: zmq.Frame) -> str:
    """Who gave a command: the key's name, which is proven, and what the program says of itself, which is not."""
    said = request.who or request.client
    if member is not None:
        return f"{member.name}, by {said}" if said else member.name
    if said:
        return said
    try:
        return f"a program at {frame.get('Peer-Address')}"
    except zmq.ZMQError:
        return "a program"


def _opened(frames: list[bytes]) -> tuple[tuple[bytes, ...], list[bytes]]:
    """The way back, and the rest: a REQ client puts an empty frame first, a DEALER need not."""
    identity, *rest = frames
    if len(rest) > 1 and rest[0] == b"":
        return (identity, b""), rest[1:]
    return (identity,), rest
