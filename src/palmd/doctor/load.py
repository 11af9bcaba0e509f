"""What else a machine may have to do: processes that keep its processors, its disk or its network busy.

Each function is a process of its own; it goes on until it is ended, or `starter`, the process number of whoever started
it, is no longer its parent.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import threading
from urllib.parse import urlsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Origin

BLOCK_BYTES = 1 << 20
FILE_BLOCKS = 64
DATAGRAM_BYTES = 1400
LOOPS = 100_000
HEARD_S = 0.5


def processor(starter: int) -> None:
    """One core, all of it."""
    while os.getppid() == starter:
        for _ in range(LOOPS):
            pass


def disk(starter: int, folder: str) -> None:
    """Blocks written and brought to the disk, over and over in one file of 64 MB that has no name."""
    block = os.urandom(BLOCK_BYTES)
    with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
        while os.getppid() == starter:
            file.seek(0)
            for _ in range(FILE_BLOCKS):
                file.write(block)
                os.fdatasync(file.fileno())


def network(starter: int) -> None:
    """Datagrams on the loopback interface, as fast as they go."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end, socket.socket(type=socket.SOCK_DGRAM) as start:
        end.bind(("127.0.0.1", 0))
        start.connect(end.getsockname())
        threading.Thread(target=_swallow, args=(end,), daemon=True).start()
        datagram = bytes(DATAGRAM_BYTES)
        while os.getppid() == starter:
            for _ in range(LOOPS // 100):
                start.send(datagram)


def browser(starter: int, page: str) -> None:
    """A live page's socket, read as a browser reads it that only watches."""
    address = urlsplit(page).netloc
    with (
        contextlib.suppress(WebSocketException, OSError),
        connect(f"ws://{address}/socket", origin=Origin(f"http://{address}"), compression=None) as stream,
    ):
        stream.send(json.dumps({"token": None}))
        while os.getppid() == starter:
            with contextlib.suppress(TimeoutError):
                stream.recv(HEARD_S)


def _swallow(end: socket.socket) -> None:
    with contextlib.suppress(OSError):  # closed by who began it
        while True:
            end.recv(DATAGRAM_BYTES)
