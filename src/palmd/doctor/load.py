"""Load generators: processes that keep the processors, the disk or the network busy.

Each function is the main function of a process; it runs until the process is ended, or until `starter`, the id of the
process that started it, is no longer its parent.
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
    """Use one core completely."""
    while os.getppid() == starter:
        for _ in range(LOOPS):
            pass


def disk(starter: int, folder: str) -> None:
    """Write and sync blocks repeatedly in one unnamed file of 64 MB."""
    block = os.urandom(BLOCK_BYTES)
    with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
        while os.getppid() == starter:
            file.seek(0)
            for _ in range(FILE_BLOCKS):
                file.write(block)
                os.fdatasync(file.fileno())


def network(starter: int) -> None:
    """Send datagrams on the loopback interface at the highest rate."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end, socket.socket(type=socket.SOCK_DGRAM) as start:
        end.bind(("127.0.0.1", 0))
        start.connect(end.getsockname())
        threading.Thread(target=_swallow, args=(end,), daemon=True).start()
        datagram = bytes(DATAGRAM_BYTES)
        while os.getppid() == starter:
            for _ in range(LOOPS // 100):
                start.send(datagram)


def browser(starter: int, page: str) -> None:
    """Read a live page's socket as a browser that only watches."""
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
    with contextlib.suppress(OSError):  # closed by the sender
        while True:
            end.recv(DATAGRAM_BYTES)
