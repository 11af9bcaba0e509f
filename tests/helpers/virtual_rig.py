"""The daemon's real core on the emulated rig, with real sockets, in accelerated virtual time."""

import threading
from contextlib import contextmanager

from palmd.daemon.bus import Bus
from palmd.daemon.core import Core
from palmd.daemon.lifecycle import State
from palmd.rig.emulated import STEP_S
from palmd.rig.pads import GOOD_PADS
from palmd.rig.world import World
from tools.closed_loop import AtOnce
from tools.studies.stub_observers import EmptyObserver

TICK_STEPS = 20


@contextmanager
def running(real, config, seed, bodies, crossed=False, pad_options=GOOD_PADS):
    """A rig described by `real` and a daemon configured by `config`; yields the world, for fault injection.

    The first of `bodies` is on the palms, the others are for exchange. The pads' plugs may be `crossed`.
    """
    plug = {"pad1": "pad2", "pad2": "pad1"} if crossed else {}
    world = World(real, seed, bodies=bodies, pad_options=pad_options)
    core = Core(config, EmptyObserver(), AtOnce())
    bus, over = Bus(config.bus.publish, config.bus.command), threading.Event()
    ready = threading.Event()
    for end in ("pad1", "pad2", "arm"):
        core.opened(end, 0.0)

    def live():
        steps = 0
        while not over.is_set():
            steps += 1
            t = steps * STEP_S
            for end, data in world.advance(t).items():
                if data:
                    core.receive(plug.get(end, end), data, t)
            if t >= core.due():
                world.receive("arm", core.transmit(t))
            if steps % TICK_STEPS:
                continue
            requests = bus.receive()
            for topic, fields in core.step(t, requests):
                bus.publish(topic, fields, t, t)
            for reply in core.replies():
                bus.reply(reply)
            if core.state is State.READY:
                ready.set()
            over.wait(0.0 if core.setpoints.moving else 0.002)  # no hurry at rest

    thread = threading.Thread(target=live)
    thread.start()
    assert ready.wait(20.0)
    try:
        yield world
    finally:
        over.set()
        thread.join()
        bus.close()
