"""The daemon's bus under floods from real sockets: what a tick takes in and what it works, by counts and shares.

No figure of the clock's: a busy machine makes floods smaller, and nothing else.
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
"""Of a tick's period, for all that a flood has the loop do: thread time, in the median."""


@pytest.fixture
def bus(tmp_path):
    one = Bus(f"ipc://{tmp_path}/p", "tcp://127.0.0.1:*")
    yield one
    one.close()


def address(bus):
    return bus._commands.getsockopt_string(zmq.LAST_ENDPOINT)


@contextmanager
def flooded(bus, kind, clients=3):
    """Floods until the end, by processes of their own; begun when the first of them is felt, where it can be."""
    with ExitStack() as stack:
        for _ in range(clients):
            how = ("--blind", "--stay", "100", "--seconds", "600", "--command", address(bus))
            one = subprocess.Popen([sys.executable, FLOOD, kind, *how])
            stack.callback(one.wait)
            stack.callback(one.kill)
        yield


def tick(bus):
    """One tick's dealings with the bus: what came, and how long the thread worked (s)."""
    begun = time.thread_time()
    requests = bus.receive()
    for request in requests:
        bus.reply(Reply(request, None, {}))
    took = time.thread_time() - begun
    time.sleep(TICK_S)
    return requests, took


def until(bus, enough):
    """Ticks until a request is as wanted; all that came, by ticks."""
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
def test_a_tick_takes_in_a_few_and_a_stop_among_thousands_gets_its_turn(bus, kind):
    with client(bus) as operator:
        asks(operator, "hold")
        until(bus, lambda request: request.name == "hold")
        with flooded(bus, kind):
            until(bus, lambda request: request.name == "status")
            ticks = [tick(bus) for _ in range(100)]  # by then each has opened what it leaves open
            left = []
            for _ in range(100):
                before = bus.counters.commands
                ticks.append(tick(bus))
                left.append(bus.counters.commands - before == MESSAGES_PER_TICK)
            asks(operator, "stop")
            waited = until(bus, lambda request: request.name == "stop")
    assert max(len(requests) for requests, _ in ticks) <= PER_TICK
    assert sum(len(requests) for requests, _ in ticks) >= len(ticks) // 2  # they do come
    assert median(took for _, took in ticks) < WORK_MOST * TICK_S
    assert not all(left)  # what came is taken off the socket, where each client that has gone costs 30 kB until then
    assert len(waited) <= 50  # nothing piles up before it


def test_connections_that_say_nothing_reach_no_tick(bus):
    with client(bus) as operator, flooded(bus, "connections"):
        time.sleep(0.5)
        ticks = [tick(bus) for _ in range(100)]
        asks(operator, "stop")
        until(bus, lambda request: request.name == "stop")
    assert not [requests for requests, _ in ticks if requests]
    assert median(took for _, took in ticks) < WORK_MOST * TICK_S
    assert bus.counters.malformed == 0
