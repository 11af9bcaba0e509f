"""Load test of a running daemon: missed ticks and set-points under a flood of requests, as the daemon reports them.

    palmd demo --seconds 60 --no-browser &
    python tools/flood.py commands                        20,000 commands/s to the command socket
    python tools/flood.py connections --clients 3         as many connections, from three processes at once
    python tools/flood.py clients                         connections with handshake and request
    python tools/flood.py page-connections --page 8765    connections to the page's server
    python tools/flood.py page-orders --page 8765 --token TOKEN

Prints a line for each half, calm and flooded: missed ticks, duration of a tick, omitted set-points, and how many of the
attempts were accepted. Exit status 1 if the flood cost ticks or set-points.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import socket
import struct
import sys
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.sharedctypes import Synchronized
from statistics import median
from urllib.parse import urlsplit

import msgpack
import zmq
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from palmd.bus.link import COMMAND, PUBLISH
from palmd.bus.subscriber import Subscriber

RATE_HZ = 20_000.0
SLICE_S = 1e-3
STAY, GREETED = 800, 20
"""Connections of a process that are kept open, so that their data are read; the daemon needs some 35 kB for each. A
connection sends its request when `GREETED` more have been opened."""

_RESET = struct.pack("ii", 1, 0)  # linger 0: a closed connection leaves nothing behind

Once = Callable[[], bool]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--clients", type=int, default=1, metavar="N")
    parser.add_argument("--rate", type=float, default=RATE_HZ, metavar="HZ", help="rate of all clients together")
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="duration of each half")
    parser.add_argument("--command", default=COMMAND)
    parser.add_argument("--publish", default=PUBLISH)
    parser.add_argument("--page", type=int, default=8765, metavar="PORT")
    parser.add_argument("--token", default="")
    parser.add_argument("--stay", type=int, default=STAY, metavar="N", help="with `clients`: open connections")
    parser.add_argument("--blind", action="store_true", help="only flood, without measuring")
    arguments = parser.parse_args()
    tried, taken = multiprocessing.Value("q", 0), multiprocessing.Value("q", 0)
    if arguments.blind:
        _flood(arguments, tried, taken, time.monotonic() + arguments.seconds)
        print(taken.value)
        return 0
    with Subscriber(arguments.publish, topics=("palm/loop",)) as subscriber:
        calm = _watched(subscriber, arguments.seconds)
        clients = [
            multiprocessing.Process(target=_flood, args=(arguments, tried, taken), daemon=True)
            for _ in range(arguments.clients)
        ]
        for each in clients:
            each.start()
        flooded = _watched(subscriber, arguments.seconds)
        for each in clients:
            each.terminate()
    _print_row("calm", calm)
    _print_row("flooded", flooded)
    print(f"  {tried.value / arguments.seconds:.0f} attempts/s, {taken.value / arguments.seconds:.0f} accepted/s")
    costs = any(flooded[name] > calm[name] for name in ("ticks missed", "set-points left out"))
    return 1 if costs else 0


def _watched(subscriber: Subscriber, seconds: float) -> dict[str, float]:
    """Statistics from the daemon's `palm/loop` within so many seconds."""
    rows = [message.fields for message in subscriber.until(time.monotonic() + seconds)]
    if len(rows) < 2:
        raise SystemExit("no messages from the daemon: is it running?")
    first, last = rows[0], rows[-1]
    return {
        "ticks missed": last["overruns"] - first["overruns"],
        "set-points left out": last["arm_skipped_periods"] - first["arm_skipped_periods"],
        "median work, ms": median(each["work_p50_ms"] for each in rows[1:]),
        "work p99, ms": median(each["work_p99_ms"] for each in rows[1:]),
        "lateness p99, ms": median(each["lateness_p99_ms"] for each in rows[1:]),
        "commands": last["bus_commands"] - first["bus_commands"],
        "MB": last["rss_mb"],
    }


def _print_row(name: str, row: dict[str, float]) -> None:
    print(f"{name}: " + ", ".join(f"{what} {number:.3g}" for what, number in row.items()), flush=True)


def _flood(
    arguments: argparse.Namespace, tried: Synchronized[int], taken: Synchronized[int], t_end: float = math.inf
) -> None:
    once, share = KINDS[arguments.kind](arguments), arguments.rate / arguments.clients
    t_start, done = time.monotonic(), 0
    while time.monotonic() < t_end:
        due, before, accepted = round((time.monotonic() - t_start) * share), done, 0
        while done < due and done < before + 1000:
            accepted += once()
            done += 1
        with tried.get_lock(), taken.get_lock():
            tried.value += done - before
            taken.value += accepted
        time.sleep(SLICE_S)


def _commands(arguments: argparse.Namespace) -> Once:
    client = zmq.Context().socket(zmq.DEALER)
    client.connect(arguments.command)
    payload = msgpack.packb({"id": 1, "cmd": "status", "args": {}})

    def once() -> bool:
        with suppress(zmq.Again):
            while True:
                client.recv_multipart(zmq.NOBLOCK)
        with suppress(zmq.Again):
            client.send(payload, zmq.NOBLOCK)
            return True
        return False

    return once


def _clients(arguments: argparse.Namespace) -> Once:
    """Connections with a ZeroMQ handshake (ZMTP 3.0, no keys) and one request."""
    where = _bus(arguments)
    greeting = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
    ready = b"\x05READY\x0bSocket-Type\x00\x00\x00\x06DEALER"
    payload = msgpack.packb({"id": 1, "cmd": "status", "args": {}})
    request = bytes((4, len(ready))) + ready + bytes((0, len(payload))) + payload
    leaving: deque[socket.socket] = deque()

    def once() -> bool:
        if len(leaving) == arguments.stay:
            leaving.popleft().close()
        leaving.append(_connect(where))
        with suppress(OSError):
            leaving[-1].sendall(greeting)
            if len(leaving) > GREETED:
                leaving[-GREETED].sendall(request)  # libzmq needs the greeting in a packet of its own
            return True
        return False

    return once


def _connections(where: tuple[str, int]) -> Once:
    def once() -> bool:
        with _connect(where) as each:
            return _is_connected(each)

    return once


def _connect(where: tuple[str, int]) -> socket.socket:
    one = socket.socket()
    one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
    one.settimeout(0.05)
    one.connect_ex(where)
    return one


def _is_connected(one: socket.socket) -> bool:
    try:
        one.getpeername()
    except OSError:
        return False
    return True


def _bus(arguments: argparse.Namespace) -> tuple[str, int]:
    parts = urlsplit(arguments.command)
    return parts.hostname or "127.0.0.1", parts.port or 0


def _orders(arguments: argparse.Namespace) -> Once:
    host = f"127.0.0.1:{arguments.page}"
    page = connect(f"ws://{host}/socket", origin=f"http://{host}", max_size=None)  # type: ignore[arg-type]
    page.send(json.dumps({"token": arguments.token}))
    order = json.dumps({"id": 1, "cmd": "hold"})

    def once() -> bool:
        with suppress(WebSocketException, OSError):
            page.send(order)
            return True
        return False

    return once


KINDS: dict[str, Callable[[argparse.Namespace], Once]] = {
    "commands": _commands,
    "clients": _clients,
    "connections": lambda arguments: _connections(_bus(arguments)),
    "page-connections": lambda arguments: _connections(("127.0.0.1", arguments.page)),
    "page-orders": _orders,
}

if __name__ == "__main__":
    sys.exit(main())
