"""The marble on the emulated rig: over its own pad, instead of the object, smooth and slow."""

import numpy as np
import pytest

from palmd.devices.versapad import VersaPadDecoder
from palmd.rig.fault_injection import order
from palmd.rig.marble import Marble
from palmd.rig.pads import WIDTH_M
from palmd.rig.world import World, default_config

LENGTH_M = 0.0555


@pytest.fixture(params=range(5))
def marble(request):
    return Marble(LENGTH_M, np.random.default_rng(request.param))


def test_it_covers_most_of_the_pad_and_presses_up_to_two_newtons(marble):
    presses = [press for t in np.arange(0.0, 60.0, 0.01) for press in marble.presses(t)]
    s, across, force = (np.array([getattr(p, name) for p in presses]) for name in ("s", "across", "force"))
    assert 0.0 < s.min() < 0.1 * LENGTH_M < 0.9 * LENGTH_M < s.max() < LENGTH_M
    assert -0.5 * WIDTH_M < across.min() < -0.4 * WIDTH_M < 0.4 * WIDTH_M < across.max() < 0.5 * WIDTH_M
    assert 0.0 < force.min() < 0.03
    assert 1.8 < force.max() <= 2.0
    assert 0.6 * 6000 < len(presses) < 0.95 * 6000  # with occasional lift-offs


def test_it_is_never_faster_than_a_hand(marble):
    dt = 0.001
    for t in np.arange(0.0, 60.0, 0.01):
        before, after = marble.presses(t), marble.presses(t + dt)
        if before and after:
            assert np.hypot(after[0].s - before[0].s, after[0].across - before[0].across) < 0.110 * dt
            assert abs(after[0].force - before[0].force) < 4.0 * dt


def heard(world, seconds):
    """The number of touching reports that each pad has sent."""
    decoders = {name: VersaPadDecoder(9600) for name in ("pad1", "pad2")}
    reports = dict.fromkeys(decoders, 0)
    for k in range(1, round(seconds * 1e3) + 1):
        out = world.advance(world.t + 1e-3)
        for name, decoder in decoders.items():
            reports[name] += sum(packet.in_use for packet in decoder.feed(out[name], k * 1e-3))
    return reports


@pytest.mark.parametrize(("marbles", "silent"), [(("pad1",), "pad2"), (("pad2",), "pad1"), (("pad1", "pad2"), None)])
def test_it_rolls_over_its_own_pad_instead_of_the_object(marbles, silent):
    world = World(default_config(), 1, marbles=marbles)
    world.fault_injector.add(order("swap", 0.5))  # a hand busy with the marble places no object on the palms
    reports = heard(world, 3.0)
    assert all(reports[name] > 100 for name in marbles)
    assert silent is None or reports[silent] == 0
    assert not world.status()["on_palms"]


def test_the_same_seed_rolls_the_same_curve():
    first, again, other = (World(default_config(), seed, marbles=("pad1",)).advance(1.0) for seed in (1, 1, 2))
    assert first == again
    assert first["pad1"] != other["pad1"]
