"""The daemon's bus under floods from real sockets: counts and shares of what a tick reads and of its work.

No test uses absolute time: a busy machine only makes the floods smaller.
"""

import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median

import msgpack
import pytest
import zmq

from palmd.daemon.bus import MESSAGES_PER_TICK, Bus
from palmd.daemon.command_queue import PER_TICK
from palmd.daemon.commands import Reply

FLOOD = Path(__file__).parents[3] / "tools/flood.py"
TICK_S = 0.01
PATIENCE_S = 30.0
WORK_MOST = 0.2
"""Limit of the median thread time that a flood may cost the loop, as a share of the tick's period."""


@pytest.fixture
def bus(tmp_path):
    one = Bus(f"ipc://{tmp_path}/p", "tcp://127.0.0.1:*")
    yield one
    one.close()


def address(bus):
    return bus._commands.getsockopt_string(zmq.LAST_ENDPOINT)


@contextmanager
def flooded(bus, kind, clients=3):
    """Floods by separate processes until the end; begins when the first of them has an effect (if observable)."""
    with ExitStack() as stack:
        for _ in range(clients):
            how = ("--blind", "--stay", "100", "--seconds", "600", "--command", address(bus))
            one = subprocess.Popen([sys.executable, FLOOD, kind, *how])
            stack.callback(one.wait)
            stack.callback(one.kill)
        yield


def tick(bus):
    """One tick of the bus: the requests, and the thread's working time (s)."""
    begun = time.thread_time()
    requests = bus.receive()
    for request in requests:
        bus.reply(Reply(request, None, {}))
    took = time.thread_time() - begun
    time.sleep(TICK_S)
    return requests, took


def until(bus, enough):
    """Ticks until a request satisfies the condition; all requests by tick."""
    t_end, came = time.monotonic() + PATIENCE_S, []
    while time.monotonic() < t_end:
        came.append(tick(bus)[0])
        if any(map(enough, came[-1])):
            return came
    raise AssertionError("it never came")


def client(bus):
    socket = zmq.Context.instance().socket(zmq.DEALER)
    socket.connect(address(bus))
    return socket


def asks(socket, command):
    socket.send(msgpack.packb({"id": 7, "cmd": command, "args": {}, "from": "operator"}))


@pytest.mark.parametrize("kind", ["commands", "clients"])
def test_a_tick_reads_a_few_requests_and_a_stop_among_thousands_is_served(bus, kind):
    with client(bus) as operator:
        asks(operator, "hold")
        until(bus, lambda request: request.name == "hold")
        with flooded(bus, kind):
            until(bus, lambda request: request.name == "status")
            ticks = [tick(bus) for _ in range(50)]  # by then each flooder has opened its idle connections
            left = []
            for _ in range(50):
                before = bus.counters.commands
                ticks.append(tick(bus))
                left.append(bus.counters.commands - before == MESSAGES_PER_TICK)
            asks(operator, "stop")
            waited = until(bus, lambda request: request.name == "stop")
    assert max(len(requests) for requests, _ in ticks) <= PER_TICK
    assert sum(len(requests) for requests, _ in ticks) >= len(ticks) // 2  # requests do arrive
    assert median(took for _, took in ticks) < WORK_MOST * TICK_S
    assert not all(left)  # the socket is emptied; until then each vanished client costs 30 kB
    assert len(waited) <= 50  # no backlog before it


def test_silent_connections_reach_no_tick(bus):
    with client(bus) as operator, flooded(bus, "connections"):
        time.sleep(0.5)
        ticks = [tick(bus) for _ in range(50)]
        asks(operator, "stop")
        until(bus, lambda request: request.name == "stop")
    assert not [requests for requests, _ in ticks if requests]
    assert median(took for _, took in ticks) < WORK_MOST * TICK_S
    assert bus.counters.malformed == 0
