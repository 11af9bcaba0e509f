"""The live page's server in a thread, scripted sockets of a daemon, and messages that a page receives."""

import asyncio
import contextlib
import http.client
import json
import re
import socket
import threading
import time

import msgpack
import zmq
from websockets.sync.client import connect

from palmd.cli.view import allowed
from palmd.view.server import Settings, serve_page

PATIENCE_S = 60.0  # for palmd commands on a busy machine
TOKEN = "open sesame"


class Daemon:
    """Publisher and command socket of a daemon; it sends scripted answers."""

    def __init__(self):
        self._context = zmq.Context()
        self._publisher = self._context.socket(zmq.PUB)
        self.publish = f"tcp://127.0.0.1:{self._publisher.bind_to_random_port('tcp://127.0.0.1')}"
        self._commands = None
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.command = f"tcp://127.0.0.1:{probe.getsockname()[1]}"

    def say(self, topic, fields):
        self.send(topic.encode(), msgpack.packb(fields), b"1.0")

    def send(self, *frames):
        self._publisher.send_multipart(frames)

    def take_commands(self):
        self._commands = self._context.socket(zmq.ROUTER)
        self._commands.bind(self.command)

    def asked(self, wait_s=PATIENCE_S):
        """The next command and its return route; None if none comes."""
        if not self._commands.poll(wait_s * 1e3):
            return None
        route, payload = self._commands.recv_multipart()
        return route, msgpack.unpackb(payload)

    def reply(self, route, **fields):
        self._commands.send_multipart([route, msgpack.packb(fields)])

    def close(self):
        self._context.destroy(linger=0)


class Served:
    """The page's server in its own thread."""

    def __init__(self, daemon, **more):
        self._ready = threading.Event()
        self._settings = Settings(daemon.publish, daemon.command, "", 0, TOKEN, allowed(), **more)
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()))
        self._thread.start()
        assert self._ready.wait(PATIENCE_S)

    async def _serve(self):
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        await serve_page(self._settings, self._is_ready, self._stop)

    def _is_ready(self, url):
        self.url = url
        self.port = int(re.fullmatch(r"http://127\.0\.0\.1:(\d+)/#token=open sesame", url)[1])
        self._ready.set()

    def close(self):
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(PATIENCE_S)
        assert not self._thread.is_alive()

    def get(self, path, **headers):
        """Status, headers and body of a request; the path is sent unchanged."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        with contextlib.closing(connection):
            connection.putrequest("GET", path, skip_host="Host" in headers)
            for name, value in headers.items():
                connection.putheader(name, value)
            connection.endheaders()
            response = connection.getresponse()
            return response.status, response.headers, response.read()

    @contextlib.contextmanager
    def page(self, token=TOKEN):
        """A page's socket, and the first message to it."""
        with self.socket() as opened:
            opened.send(json.dumps({"token": token}))
            yield opened, json.loads(opened.recv(PATIENCE_S))["hello"]

    def socket(self, origin=None, host="127.0.0.1"):
        here = f"{host}:{self.port}"
        return connect(f"ws://{here}/socket", origin=origin or f"http://{here}", proxy=None, close_timeout=1)


def said(page, kind, what):
    """Messages of one kind (text or bytes) to a page, until a time-out."""
    t_end = time.monotonic() + PATIENCE_S
    while time.monotonic() < t_end:
        message = page.recv(PATIENCE_S)
        if isinstance(message, kind):
            yield message
    raise AssertionError(f"time-out waiting for {what}")


def batches(page):
    """Batches: (lost, commandable, {topic: payload})."""
    for message in said(page, bytes, "a batch"):
        _, lost, commandable, messages = msgpack.unpackb(message)
        yield lost, commandable, messages


def answers(page):
    """Answers to a page's commands."""
    for message in said(page, str, "the answer to a command"):
        yield json.loads(message)["answer"]


def heard(page, *topics):
    """Messages until each of the topics has come."""
    found = []
    for _, _, messages in batches(page):
        found += messages
        if {topic for topic, _ in found} >= set(topics):
            break
    return found


def answer(page, command):
    """The error (or None) in the answer to a page's command."""
    page.send(json.dumps({"id": 7, "cmd": command}))
    reply_fields = next(answers(page))
    assert (reply_fields["id"], reply_fields["cmd"]) == (7, command)
    return reply_fields["error"]


def until_commandable(page):
    assert any(commandable for _, commandable, _ in batches(page))
