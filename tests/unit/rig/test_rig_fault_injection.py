"""Fault injection: orders, their times, and their effect on bytes."""

import numpy as np
import pytest

from palmd.rig.fault_injection import INJECTABLE_FAULTS, FaultInjector, InjectionError, order, parse


def rng():
    return np.random.default_rng(1)


def board(*texts, t=0.0):
    switchboard = FaultInjector()
    for text in texts:
        switchboard.add(parse(text, t))
    switchboard.update(t)
    return switchboard


def test_every_fault_can_be_ordered_by_name():
    for name, trick in INJECTABLE_FAULTS.items():
        assert trick.name == name
        assert len(trick.description) > 10
        assert len(order(name, 0.0)) == max(1, len(trick.ports))


def test_text_form():
    (found,) = parse("drop@pad2,strength=0.2,after=3,for=2", 10.0)
    assert (found.name, found.port, found.strength, found.t_on, found.t_off) == ("drop", "pad2", 0.2, 13.0, 15.0)


@pytest.mark.parametrize(
    "text",
    [
        "nonsense",
        "drop@lpt1",
        "touch@arm",
        "lift@pad1",
        "drop,strength",
        "drop,strength=x",
        "drop,often=3",
        "drop,strength=-1",
        "drop,strength=nan",
        "drop,for=0",
        "drop,after=-1",
        "",
    ],
)
def test_invalid_orders_are_refused(text):
    with pytest.raises(InjectionError):
        parse(text, 0.0)


def test_orders_begin_and_end_on_time():
    switchboard = board("mute@pad1,after=1,for=2")
    seen = {t: [(o.name, begins) for o, begins in switchboard.update(t)] for t in (0.5, 1.0, 2.9, 3.0, 4.0)}
    assert seen == {0.5: [], 1.0: [("mute", True)], 2.9: [], 3.0: [("mute", False)], 4.0: []}


def test_orders_can_be_cancelled():
    switchboard = board("mute", "estop,after=5")
    assert sorted(switchboard.names()) == ["mute@arm", "mute@pad1", "mute@pad2"]
    switchboard.cancel("mute", "pad1")
    switchboard.cancel("estop", None)
    assert [(o.port, begins) for o, begins in switchboard.update(1.0)] == [("pad1", False)]
    assert sorted(switchboard.names()) == ["mute@arm", "mute@pad2"]
    assert switchboard.update(9.0) == []
    with pytest.raises(InjectionError):
        switchboard.cancel("nonsense", None)


def test_bytes_are_unchanged_without_a_fault():
    switchboard = board("drop@pad1,strength=1")
    assert switchboard.corrupt("pad2", b"hello", rng()) == b"hello"
    assert switchboard.corrupt("pad1", b"hello", rng()) == b""


def test_drop_and_garble_affect_about_the_requested_share():
    data = bytes(5000)
    assert len(board("drop@arm,strength=0.3").corrupt("arm", data, rng())) == pytest.approx(3500, abs=150)
    spoilt = board("garble@arm,strength=0.3").corrupt("arm", data, rng())
    assert len(spoilt) == pytest.approx(6000, abs=150)  # a third flipped, two thirds with a byte more
    assert sum(byte != 0 for byte in spoilt) == pytest.approx(1000, abs=150)


def test_mute_and_misbaud():
    assert board("mute@arm").corrupt("arm", b"hello", rng()) == b""
    noise = board("misbaud@arm").corrupt("arm", b"a" * 100, rng())
    assert noise.count(b"a") < 10
