"""The loop between its ticks, on a simulated clock: events shortly before a deadline do not delay the tick."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmd.daemon import loop as module
from palmd.daemon.lifecycle import State
from palmd.daemon.loop import Loop
from palmd.daemon.systemd import Notifier

PERIOD_S, TICKS = 0.01, 4
WORK_S = 0.2e-3  # to process some bytes, or to compute a set-point
EVENT_S = 2.5e-3  # to process a late event
LOOK_S = 2e-6  # to read the clock

times = st.floats(0.0, TICKS * PERIOD_S)


class World:
    """Time that passes only by work, three ports, and a core that needs time for their bytes."""

    path, error, is_open = "wire", None, True
    state, at_rest, pads = State.READY, True, {}
    faults = SimpleNamespace(active=())
    counters = SimpleNamespace(as_dict=dict)

    def __init__(self, arrivals, setpoints):
        self.now = 0.0
        self.coming, self.setpoints = sorted(arrivals), sorted(setpoints)
        self.received, self.sent = [], []
        self.ticks = self.backlog = 0

    def clock(self):
        self.now += LOOK_S
        return self.now

    def __getattr__(self, name):
        """Any other attribute of a core or a port takes no time and returns nothing."""
        return lambda *_: ()

    def wait(self, t_end):
        self.now = max(self.now, min([t_end, *self.coming[:1]]))
        return [self] if self.coming and self.coming[0] <= self.now else []

    def read(self):
        count = sum(t <= self.now for t in self.coming)
        come, self.coming = self.coming[:count], self.coming[count:]
        return " ".join(map(repr, come)).encode()

    def observe(self, _t, between):
        """Uses all of its time: delayed bytes come all at once."""
        while self.backlog:
            self.backlog -= 1
            self.now += EVENT_S
            if not between():
                break

    def receive(self, _end, data, t):
        self.received += [(float(came), t) for came in data.split()]
        self.now += WORK_S

    def due(self):
        return self.setpoints[0] if self.setpoints else math.inf

    def decide(self, _t):
        self.ticks += 1
        if self.ticks > TICKS:
            self.loop.stop()

    def transmit(self, t):
        self.sent.append((self.setpoints.pop(0), t))
        self.now += WORK_S
        return b"S"


def run(world):
    """Runs some ticks of a loop in that world; the delay of each (s)."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PortWaiter", lambda _ports, _clock: world)
        wires = {"pad1": world, "pad2": world, "arm": world}
        bus = SimpleNamespace(receive=tuple, publish=lambda *_: None, fields=dict)
        loop = world.loop = Loop(
            world, wires, bus, Notifier({}), rate_hz=1 / PERIOD_S, backend="", info={}, clock=world.clock
        )
        loop._t_slow = math.inf  # palm/loop needs processor times that are not simulated
        loop.run()
        world.overruns = loop.statistics.overruns
    return [ms * 1e-3 for ms in loop.statistics.fields()["lateness_ms"] if ms]


@given(st.lists(times, max_size=15, unique=True), st.lists(times, max_size=3, unique=True))
def test_a_tick_begins_at_its_deadline_whatever_precedes_it(arrivals, setpoints):
    late = run(World(arrivals, setpoints))
    assert len(late) > TICKS
    assert max(late) <= 3 * LOOK_S


@given(st.lists(times, max_size=15, unique=True), st.lists(times, max_size=3, unique=True))
def test_every_byte_is_dated_at_its_arrival_and_every_set_point_is_sent(arrivals, setpoints):
    world = World(arrivals, setpoints)
    run(world)
    assert [came for came, _ in world.received] == sorted(arrivals)
    assert all(0.0 <= t - came <= 2 * WORK_S * 18 for came, t in world.received)
    assert len(world.sent) == len(setpoints)


def test_a_backlog_is_read_over_several_ticks():
    world = World([], [])
    world.backlog = 6
    assert max(run(world)) <= 3 * LOOK_S
    assert world.backlog == 0
    assert world.overruns == 0


def test_bytes_of_the_last_moment_are_dated_before_the_tick_and_processed_in_it():
    before = 3 * PERIOD_S
    world = World([before - 0.25e-3, before - 0.15e-3], [])
    run(world)
    assert [t - came for came, t in world.received] == pytest.approx([0.0, 0.0], abs=3 * LOOK_S)


def test_a_set_point_due_in_the_last_moment_is_sent_with_the_tick():
    due = 3 * PERIOD_S - 0.2e-3
    world = World([], [due])
    run(world)
    assert world.sent[0][1] - due <= module.QUIET_S + 20 * LOOK_S
