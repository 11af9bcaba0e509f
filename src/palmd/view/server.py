"""The page's server: relays batches of messages to every browser and commands to the daemon, in one thread."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, cast

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from palmd import __version__
from palmd.bus.command_client import own_client
from palmd.console.errors import BAD_INPUT, CliError
from palmd.keys import Credentials
from palmd.view import http_guard, naming, wire
from palmd.view.client import PageClient
from palmd.view.daemon_link import Feed, PageCommands, Payload
from palmd.view.http_guard import page_files
from palmd.view.library import COMMANDS as LIBRARY_COMMANDS
from palmd.view.library import LibraryError, RunLibrary

log = logging.getLogger(__name__)

HOST = "127.0.0.1"
FRAME_S = 1 / 12
"""Period of batches (s), one picture each (study 2026-12-01: the browser takes 15.0 % of a core, with 1/15 17 %)."""

HEARTBEAT_FRAMES = int(0.5 / FRAME_S)
"""A batch is sent at least this often, even without messages (convention: twice a second)."""

HELLO_S = 5.0
CLOSING_S = 1.0
MESSAGE_BYTES_MAX = 4096
SEND_BUFFER_BYTES = 1 << 16  # kernel buffer for a slow page: about half a second
MAX_CLIENTS = 32
MAX_WATCHERS = 24
"""Most pages without the token; the other places are reserved for pages that may operate the rig."""
MAX_PENDING = 64
"""Most connections that are not yet pages; one more closes the oldest, so that a flood cannot lock others out."""

ACCEPTED_AT_ONCE, BACKLOG = 8, 128
"""Connections accepted in one step (pages get their frames in between), and connections that may wait."""

MAX_ORDERS = 8
"""Most unanswered orders of a page: all orders share one queue to the daemon, and a `stop` must not wait in it behind a
flood."""

STOPPING_COMMANDS = ("stop", "hold")
"""Commands that are accepted beyond `MAX_ORDERS`, unless the page already waits for the same one."""
_REFUSED, _TOO_MANY = 1008, 1013  # WebSocket close codes "policy violation" and "try again later"


@dataclass(frozen=True, slots=True)
class Settings:
    """Addresses of the daemon, port of the page, and commands.

    `truth` is an emulated rig's publisher, empty for none. `allowed` lists the states in which each command applies.
    With a `key` the page has the rights that the daemon grants to that key. `runs` is the folder of recordings, None
    for the one in `config`; without either the page shows none.
    """

    publish: str
    command: str
    truth: str
    port: int
    token: str
    allowed: Mapping[str, Sequence[str]]
    key: Credentials | None = None
    runs: Path | None = None
    config: Path | None = None


async def serve_page(settings: Settings, ready: Callable[[str], None], stop: asyncio.Event) -> None:
    """Serve until `stop`; `ready` is called with the page's address including the token. Raises CliError."""
    feed = Feed(settings.publish, settings.truth, settings.key)
    try:
        commands, library = PageCommands(settings.command, settings.key), RunLibrary(settings.runs, settings.config)
        try:
            await _Server(settings, feed, commands, library).run(ready, stop)
        finally:
            commands.close()
            library.close()
    finally:
        feed.close()


class _Server:
    def __init__(self, settings: Settings, feed: Feed, commands: PageCommands, library: RunLibrary) -> None:
        self._settings, self._feed, self._commands, self._library = settings, feed, commands, library
        self._jobs: set[asyncio.Task[None]] = set()  # running library commands
        self._files = page_files()
        self._frame = 0
        self._clients: dict[PageClient, None] = {}  # in order of connection
        self._numbers = itertools.count(1)
        self._orders: dict[int, tuple[PageClient, wire.Order]] = {}
        self._pending: dict[ServerConnection, None] = {}

    async def run(self, ready: Callable[[str], None], stop: asyncio.Event) -> None:
        pending = logging.getLogger("palmd.view.connections")
        pending.setLevel(logging.CRITICAL)  # bad requests to an open port are not worth logging
        try:
            listener = socket.create_server((HOST, self._settings.port))
        except OSError as error:
            where, why = f"{HOST}:{self._settings.port}", os.strerror(error.errno or 0)
            raise CliError(BAD_INPUT, f"{where}: cannot be bound ({why}); try another --port") from None
        with listener:
            server = await serve(
                self._serve_page,
                sock=listener,
                process_request=self._answer,
                compression=None,
                max_size=MESSAGE_BYTES_MAX,
                open_timeout=HELLO_S,
                close_timeout=CLOSING_S,
                backlog=ACCEPTED_AT_ONCE,
                create_connection=cast(Any, partial(_Connection, self._pending)),  # any factory will do
                server_header=None,
                logger=pending,
            )
            listener.listen(BACKLOG)  # asyncio uses the number accepted at once as backlog
            async with server:
                port = next(iter(server.sockets)).getsockname()[1]
                ready(f"http://{HOST}:{port}/#token={self._settings.token}")
                frames = asyncio.create_task(self._frames())
                names = asyncio.create_task(self._classify_shapes())
                stopped = asyncio.create_task(stop.wait())
                await asyncio.wait((frames, stopped), return_when=asyncio.FIRST_COMPLETED)
                stopped.cancel()
                names.cancel()
                for job in self._jobs:
                    job.cancel()
                if frames.done():
                    frames.result()
                frames.cancel()

    async def _answer(self, _connection: ServerConnection, request: Request) -> Response | None:
        response = http_guard.answer(request, self._files)
        if response is not None and response.status_code == HTTPStatus.NOT_FOUND:
            read = self._library.find(request.path)
            if read is not None:
                return http_guard.library_file(await asyncio.to_thread(read))
        return response

    # -- to the pages -------------------------------------------------------------------------------------

    async def _frames(self) -> None:
        """Each frame: receive messages and answers, and pass them on."""
        clock = asyncio.get_running_loop().time
        due, last_offer = clock(), 0
        commandable = False
        while True:
            due = max(due + FRAME_S, clock())
            await asyncio.sleep(due - clock())
            self._frame += 1
            messages = self._feed.take()
            self._pass_answers(clock())
            before, commandable = commandable, self._commands.open
            if messages or commandable is not before or self._frame - last_offer >= HEARTBEAT_FRAMES:
                last_offer = self._frame
                self._offer(self._clients, messages)

    async def _classify_shapes(self) -> None:
        """Classify the outline every few seconds while a page is connected; log a new reason for failure once."""
        wrong = ""
        while True:
            await asyncio.sleep(naming.PERIOD_S)
            if not self._clients:
                continue
            before, wrong = wrong, ""
            try:
                message = await asyncio.to_thread(naming.shape_class_message, dict(self._feed.latest))
            except naming.NamingError as error:
                wrong, message = str(error), None
                if wrong != before:
                    log.warning("the outline cannot be classified: %s", wrong)
            if message is not None:
                self._feed.latest[naming.TOPIC] = message
                self._offer(self._clients, [(naming.TOPIC, message)])

    def _offer(self, clients: Iterable[PageClient], messages: list[Payload]) -> None:
        commandable = self._commands.open
        for client in clients:
            client.offer(self._frame, commandable, messages, self._feed.latest.items())

    def _pass_answers(self, t: float) -> None:
        for answer in self._commands.answers(t):
            client, order = self._orders.pop(answer.number)
            client.waiting.remove(order.command)
            client.send_answer(wire.answer(order, answer.error))

    # -- from the pages -----------------------------------------------------------------------------------

    async def _serve_page(self, connection: ServerConnection) -> None:
        """Serve one page, from its first message to its end."""
        try:
            first = wire.token_in(await asyncio.wait_for(connection.recv(), HELLO_S))
        except (TimeoutError, ConnectionClosed):
            first = None
        if first is None:
            await connection.close(_REFUSED, "the first message must be a map with a token")
            return
        settings, (token, mark) = self._settings, first
        operator = http_guard.may_operate(token, settings.token)
        if not await self._admit(operator):
            most = MAX_CLIENTS if operator else MAX_WATCHERS
            await connection.close(_TOO_MANY, f"{most} such pages are already connected")
            return
        connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._pending.pop(connection, None)
        client = PageClient(connection, operator, f"page {mark or next(self._numbers)} of {own_client()}")
        addresses = settings.publish, settings.command
        key = self._library.key if operator else ""
        client.send_answer(wire.hello(__version__, operator, *addresses, settings.allowed, client.name, key))
        self._offer([client], [])
        self._clients[client] = None
        sending = asyncio.create_task(client.serve())
        try:
            async for message in connection:
                self._take_order(client, message)
        except ConnectionClosed:
            pass
        finally:
            self._clients.pop(client, None)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    async def _admit(self, operator: bool) -> bool:
        """Whether another page may connect; a page with the token displaces the newest one without, if necessary."""
        watchers = [client for client in self._clients if not client.operator]
        if not operator:
            return len(watchers) < MAX_WATCHERS and len(self._clients) < MAX_CLIENTS
        if len(self._clients) >= MAX_CLIENTS and watchers:
            del self._clients[watchers[-1]]
            await watchers[-1].close(_TOO_MANY, "its place is needed for a page that operates the rig")
        return len(self._clients) < MAX_CLIENTS

    def _take_order(self, client: PageClient, message: str | bytes) -> None:
        """Pass an order on to the daemon, or answer why not."""
        order = wire.order_in(message)
        if order is None:
            return
        if not client.operator:
            client.send_answer(wire.answer(order, "this page is read-only: it was opened without the token"))
        elif order.command in LIBRARY_COMMANDS:
            self._start_library_job(client, order)
        elif order.command not in self._settings.allowed:
            client.send_answer(wire.answer(order, "unknown command"))
        elif len(client.waiting) >= MAX_ORDERS and (
            order.command not in STOPPING_COMMANDS or order.command in client.waiting
        ):
            client.send_answer(wire.answer(order, f"too many at once: {len(client.waiting)} wait for their answers"))
        else:
            number = self._commands.send(order.command, order.args, asyncio.get_running_loop().time(), client.name)
            if number is None:
                client.send_answer(wire.answer(order, f"no daemon accepts commands at {self._settings.command}"))
            else:
                self._orders[number] = (client, order)
                client.waiting.append(order.command)

    def _start_library_job(self, client: PageClient, order: wire.Order) -> None:
        """Start a library command of a page; it runs beside the frames."""
        if len(self._jobs) >= MAX_ORDERS:
            client.send_answer(wire.answer(order, f"too many at once: {len(self._jobs)} wait for their answers"))
            return
        job = asyncio.create_task(self._send_result(client, order))
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)

    async def _send_result(self, client: PageClient, order: wire.Order) -> None:
        try:
            client.send_answer(wire.answer(order, None, await self._library.execute(order.command, order.args)))
        except LibraryError as error:
            client.send_answer(wire.answer(order, str(error)))


class _Connection(ServerConnection):
    """A connection that is listed in `pending` until it becomes a page or ends."""

    def __init__(self, pending: dict[ServerConnection, None], *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._pending = pending

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Add the connection; close the oldest pending one if there are too many."""
        super().connection_made(transport)
        self._pending[self] = None
        if len(self._pending) > MAX_PENDING:
            oldest = next(iter(self._pending))
            del self._pending[oldest]
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection."""
        self._pending.pop(self, None)
        super().connection_lost(exc)
