"""The page's server: 60 batches a second to every browser, their commands to the daemon, all in one thread."""

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
from palmd.view.command_client import PageCommands
from palmd.view.feed import Feed, Payload
from palmd.view.files import page_files
from palmd.view.library import COMMANDS as LIBRARY_COMMANDS
from palmd.view.library import LibraryError, RunLibrary

log = logging.getLogger(__name__)

HOST = "127.0.0.1"
FRAME_S = 1 / 30  # the page draws a picture for each
HEARTBEAT_FRAMES = 15  # a batch goes out as often even when nothing was published
HELLO_S = 5.0
CLOSING_S = 1.0
MESSAGE_BYTES_MAX = 4096
SEND_BUFFER_BYTES = 1 << 16  # what the kernel may hold back for a slow page: about half a second
CLIENTS_MOST = 32
WATCHERS_MOST = 24
"""Of them without the token: the other places are kept for those who may operate the rig."""
STRANGERS_MOST = 64
"""Connections that have not yet become a page; for one more the oldest has to go, so that a flood keeps nobody out."""

ACCEPTED_AT_ONCE, KNOCKING_MOST = 8, 128
"""Of those who knock so many are let in at once, for between them the pages get their frames; and so many may wait."""

ORDERS_MOST = 8
"""Of a page that wait for their answers: all pages' orders go to the daemon in one queue, and nobody's `stop` shall
wait in it behind a flood."""

ENDING = ("stop", "hold")
"""Orders that are let through all the same, unless the page already waits for one."""
_REFUSED, _TOO_MANY = 1008, 1013  # WebSocket's close codes for a breach of policy, and for "try again later"


@dataclass(frozen=True, slots=True)
class Settings:
    """Where the daemon is, where the page is served, and what its commands are.

    `truth` is an emulated rig's publisher, empty for none. `allowed` names the states in which each command applies.
    With a `key` the page may do what the daemon lets the key's owner do. `runs` is the folder of recordings, None for
    the one that `config` names; without either the page shows none.
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
    """Serves until `stop`; `ready` is told the page's address, token included. Raises CliError when it cannot."""
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
        self._jobs: set[asyncio.Task[None]] = set()  # of the library, on their way
        self._files = page_files()
        self._frame = 0
        self._clients: dict[PageClient, None] = {}  # in the order in which they came
        self._numbers = itertools.count(1)
        self._orders: dict[int, tuple[PageClient, wire.Order]] = {}
        self._strangers: dict[ServerConnection, None] = {}

    async def run(self, ready: Callable[[str], None], stop: asyncio.Event) -> None:
        strangers = logging.getLogger("palmd.view.connections")
        strangers.setLevel(logging.CRITICAL)  # what others do to an open port is no news
        try:
            listener = socket.create_server((HOST, self._settings.port))
        except OSError as error:
            where, why = f"{HOST}:{self._settings.port}", os.strerror(error.errno or 0)
            raise CliError(BAD_INPUT, f"{where}: cannot be had ({why}); try another --port") from None
        with listener:
            server = await serve(
                self._welcome,
                sock=listener,
                process_request=self._answer,
                compression=None,
                max_size=MESSAGE_BYTES_MAX,
                open_timeout=HELLO_S,
                close_timeout=CLOSING_S,
                backlog=ACCEPTED_AT_ONCE,
                create_connection=cast(Any, partial(_Connection, self._strangers)),  # any factory will do
                server_header=None,
                logger=strangers,
            )
            listener.listen(KNOCKING_MOST)  # asyncio lets no more wait than it accepts at once
            async with server:
                port = next(iter(server.sockets)).getsockname()[1]
                ready(f"http://{HOST}:{port}/#token={self._settings.token}")
                frames = asyncio.create_task(self._frames())
                names = asyncio.create_task(self._names())
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
        """Each frame: take in what has come, and pass it on."""
        clock = asyncio.get_running_loop().time
        due, told = clock(), 0
        commandable = False
        while True:
            due = max(due + FRAME_S, clock())
            await asyncio.sleep(due - clock())
            self._frame += 1
            messages = self._feed.take()
            self._pass_answers(clock())
            before, commandable = commandable, self._commands.open
            if messages or commandable is not before or self._frame - told >= HEARTBEAT_FRAMES:
                told = self._frame
                self._offer(self._clients, messages)

    async def _names(self) -> None:
        """Every few seconds while somebody looks: what the outline looks like; why it cannot be said is logged once."""
        wrong = ""
        while True:
            await asyncio.sleep(naming.EVERY_S)
            if not self._clients:
                continue
            before, wrong = wrong, ""
            try:
                told = await asyncio.to_thread(naming.named, dict(self._feed.latest))
            except naming.NamingError as error:
                wrong, told = str(error), None
                if wrong != before:
                    log.warning("the outline has no name: %s", wrong)
            if told is not None:
                self._feed.latest[naming.TOPIC] = told
                self._offer(self._clients, [(naming.TOPIC, told)])

    def _offer(self, clients: Iterable[PageClient], messages: list[Payload]) -> None:
        commandable = self._commands.open
        for client in clients:
            client.offer(self._frame, commandable, messages, self._feed.latest.items())

    def _pass_answers(self, t: float) -> None:
        for answer in self._commands.answers(t):
            client, order = self._orders.pop(answer.number)
            client.waiting.remove(order.command)
            client.tell(wire.answer(order, answer.error))

    # -- from the pages -----------------------------------------------------------------------------------

    async def _welcome(self, connection: ServerConnection) -> None:
        """One page, from its first message to its end."""
        try:
            first = wire.token_in(await asyncio.wait_for(connection.recv(), HELLO_S))
        except (TimeoutError, ConnectionClosed):
            first = None
        if first is None:
            await connection.close(_REFUSED, "the first message must be a map with a token")
            return
        settings, (token, mark) = self._settings, first
        operator = http_guard.may_operate(token, settings.token)
        if not await self._has_place(operator):
            most = CLIENTS_MOST if operator else WATCHERS_MOST
            await connection.close(_TOO_MANY, f"there are {most} such pages already")
            return
        connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._strangers.pop(connection, None)
        client = PageClient(connection, operator, f"page {mark or next(self._numbers)} of {own_client()}")
        addresses = settings.publish, settings.command
        key = self._library.key if operator else ""
        client.tell(wire.hello(__version__, operator, *addresses, settings.allowed, client.name, key))
        self._offer([client], [])
        self._clients[client] = None
        sending = asyncio.create_task(client.serve())
        try:
            async for message in connection:
                self._obey(client, message)
        except ConnectionClosed:
            pass
        finally:
            self._clients.pop(client, None)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    async def _has_place(self, operator: bool) -> bool:
        """Whether another page may come; for one with the token the newest without it has to go, if need be."""
        watchers = [client for client in self._clients if not client.operator]
        if not operator:
            return len(watchers) < WATCHERS_MOST and len(self._clients) < CLIENTS_MOST
        if len(self._clients) >= CLIENTS_MOST and watchers:
            del self._clients[watchers[-1]]
            await watchers[-1].close(_TOO_MANY, "its place is needed for a page that operates the rig")
        return len(self._clients) < CLIENTS_MOST

    def _obey(self, client: PageClient, message: str | bytes) -> None:
        """Pass an order on to the daemon, or say why not."""
        order = wire.order_in(message)
        if order is None:
            return
        if not client.operator:
            client.tell(wire.answer(order, "this page only watches: it was opened without the token"))
        elif order.command in LIBRARY_COMMANDS:
            self._look_up(client, order)
        elif order.command not in self._settings.allowed:
            client.tell(wire.answer(order, "the page has no such command"))
        elif len(client.waiting) >= ORDERS_MOST and (order.command not in ENDING or order.command in client.waiting):
            client.tell(wire.answer(order, f"too many at once: {len(client.waiting)} wait for their answers"))
        else:
            number = self._commands.send(order.command, order.args, asyncio.get_running_loop().time(), client.name)
            if number is None:
                client.tell(wire.answer(order, f"nobody takes commands at {self._settings.command}"))
            else:
                self._orders[number] = (client, order)
                client.waiting.append(order.command)

    def _look_up(self, client: PageClient, order: wire.Order) -> None:
        """Has the library do what a page asks for; it takes its time beside the frames."""
        if len(self._jobs) >= ORDERS_MOST:
            client.tell(wire.answer(order, f"too many at once: {len(self._jobs)} wait for their answers"))
            return
        job = asyncio.create_task(self._tell_result(client, order))
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)

    async def _tell_result(self, client: PageClient, order: wire.Order) -> None:
        try:
            client.tell(wire.answer(order, None, await self._library.obey(order.command, order.args)))
        except LibraryError as error:
            client.tell(wire.answer(order, str(error)))


class _Connection(ServerConnection):
    """One of the `strangers` until it is a page, or over."""

    def __init__(self, strangers: dict[ServerConnection, None], *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._strangers = strangers

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """For one too many the oldest has to go."""
        super().connection_made(transport)
        self._strangers[self] = None
        if len(self._strangers) > STRANGERS_MOST:
            oldest = next(iter(self._strangers))
            del self._strangers[oldest]
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """It is over."""
        self._strangers.pop(self, None)
        super().connection_lost(exc)
