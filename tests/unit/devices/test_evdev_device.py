"""Input devices as the kernel describes them: unsuitable ones are refused, units and the full state are read."""

import os
from pathlib import Path

import kernel_touch as kt
import pytest
from kernel_touch import FakeKernel

from palmd.config.pads import EvdevConfig
from palmd.devices import evdevport
from palmd.devices.evdevport import EvdevPort, query_device
from palmd.devices.pad import inspect_pad, make_pad
from palmd.devices.touchunits import contradictions, with_reported_units
from palmd.events import PadLift

SLOTTED = {
    kt.SLOT: (0, 0, 4, 0), kt.MT_X: (0, 0, 3000, 20), kt.MT_Y: (0, 0, 2000, 20), kt.ID: (0, 0, 65535, 0),
    kt.MT_PRESSURE: (0, 0, 255, 0), kt.X: (0, 0, 3000, 20), kt.Y: (0, 0, 2000, 20),
}  # fmt: skip
PACKETED = {code: info for code, info in SLOTTED.items() if code not in (kt.SLOT, kt.ID)}
SINGLE = {code: SLOTTED[code] for code in (kt.X, kt.Y)}


@pytest.fixture
def device(tmp_path, monkeypatch):
    """Makes a device: the emulated ioctls, the path, and the far end for its events."""
    ends = []

    def made(**values):
        path = tmp_path / f"event{len(ends)}"
        os.mkfifo(path)
        ends.append(os.open(path, os.O_RDWR | os.O_NONBLOCK))
        return FakeKernel(**values).install(monkeypatch, evdevport), str(path), ends[-1]

    yield made
    for end in ends:
        os.close(end)


NO_PADS = {
    "a keyboard": ({"keys": {30, 31}}, "a keyboard and no touch device"),
    "a mouse": ({"keys": {kt.LEFT}, "moves": {0, 1, 8}}, "a mouse and no touch device"),
    "a pointer of a virtual machine": ({"axes": SINGLE, "keys": {kt.LEFT}}, "a pointer, joystick or gamepad"),
    "a gamepad that numbers its axes through": (
        {"axes": SLOTTED | {0x2E: (0, 0, 255, 0)}, "keys": {0x130}},
        "a pointer, joystick or gamepad",
    ),
    "an accelerometer": ({"axes": SINGLE, "keys": {kt.TOUCH}, "properties": {6}}, "an accelerometer"),
    "a pointing stick": ({"axes": SINGLE, "keys": {kt.TOUCH}, "properties": {5}}, "a pointing stick"),
    "a pen tablet": ({"axes": SINGLE, "keys": {kt.TOUCH, kt.PEN}}, "it senses its pen only"),
    "slots without ids": (
        {"axes": {code: info for code, info in SLOTTED.items() if code != kt.ID}, "keys": {kt.TOUCH}},
        "slots without tracking ids",
    ),
    "the other axis only": ({"axes": {kt.Y: SLOTTED[kt.Y]}, "keys": {kt.TOUCH}}, "has no axis x"),
    "a power button": ({"keys": {116}}, "no touch device"),
}


@pytest.mark.parametrize("name", NO_PADS)
def test_a_device_that_is_no_pad_is_refused_by_name_before_it_is_grabbed(device, name):
    values, says = NO_PADS[name]
    kernel, path, _ = device(name="Some Thing", **values)
    port = EvdevPort("pad1", path)
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    assert not port.poll_open(0.0)
    assert says in port.error
    assert "Some Thing" in port.error
    assert kernel.grabbed == 0
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before


@pytest.mark.parametrize(
    ("axes", "protocol"), [(SLOTTED, "slots (type B)"), (PACKETED, "packets (type A)"), (SINGLE, "single touch")]
)
def test_touch_devices_of_every_protocol_are_opened_and_grabbed(device, axes, protocol):
    kernel, path, _ = device(axes=axes, keys={kt.TOUCH})
    port = EvdevPort("pad1", path)
    assert port.poll_open(0.0)
    assert port.device.protocol == protocol
    assert kernel.grabbed == 1
    port.close()


class Pad:
    """A driver at its open port, as in the daemon's loop."""

    def __init__(self, path, end, **config):
        values = {"kind": "evdev", "port": path, "zero_mm": 0.0, "length_mm": 300.0} | config
        self.driver, self._end, self.t = make_pad(1, EvdevConfig(**values)), end, 100.0
        self.port = self.driver.port()
        assert self.port.poll_open(self.t)
        self.driver.opened(self.t)

    def tick(self, data=b""):
        if data:
            os.write(self._end, data)
        self.driver.tend(self.port, 0.0)
        self.t += 0.01
        events = self.driver.feed(self.port.read(), self.t)
        self.driver.tend(self.port, 0.0)
        return [*events, *self.driver.poll(self.t)]


def in_mm(events):
    return ["lift" if isinstance(each, PadLift) else round(each.s * 1e3, 3) for each in events]


def a(code, value):
    return (3, code, value)


def test_after_an_overflow_the_full_state_is_read_even_if_more_events_come_in_the_same_read(device):
    kernel, path, end = device(axes=SLOTTED, keys={kt.TOUCH}, slots={kt.ID: [-1, -1], kt.MT_X: [0, 0], kt.MT_Y: [0, 0]})
    pad = Pad(path, end)
    assert pad.tick() == []
    first = kt.events(a(kt.ID, 7), a(kt.MT_X, 600), a(kt.MT_Y, 30), (1, kt.TOUCH, 1))
    assert in_mm(pad.tick(first)) == [30.0]
    kernel.pressed = {kt.TOUCH}
    kernel.slots = {kt.ID: [7, 8], kt.MT_X: [620, 2000], kt.MT_Y: [30, 40]}
    kernel.axes = kernel.axes | {kt.SLOT: (1, 0, 4, 0)}
    second = kt.events((0, 3, 0)) + kt.events(a(kt.SLOT, 1), a(kt.ID, 8), a(kt.MT_X, 2000), a(kt.MT_Y, 40))
    assert in_mm(pad.tick(second)) == [31.0], "the first contact is still down"
    assert in_mm(pad.tick(kt.events(a(kt.ID, -1)))) == [31.0]
    assert in_mm(pad.tick(kt.events(a(kt.SLOT, 0), a(kt.ID, -1), (1, kt.TOUCH, 0)))) == ["lift"]


def test_a_coordinate_not_sent_since_an_overflow_is_read(device):
    kernel, path, end = device(axes=SLOTTED, keys={kt.TOUCH}, slots={kt.ID: [-1], kt.MT_X: [0], kt.MT_Y: [0]})
    pad = Pad(path, end, axis="y", counts_per_mm=10.0, zero_mm=28.0)
    pad.tick()
    assert in_mm(pad.tick(kt.events(a(kt.ID, 7), a(kt.MT_X, 600), a(kt.MT_Y, 1300), (1, kt.TOUCH, 1)))) == [158.0]
    kernel.pressed, kernel.slots = {kt.TOUCH}, {kt.ID: [7], kt.MT_X: [640], kt.MT_Y: [1300]}
    assert in_mm(pad.tick(kt.events((0, 3, 0)) + kt.events(a(kt.MT_X, 640)))) == [158.0]
    assert in_mm(pad.tick(kt.events(a(kt.MT_X, 650)))) == [158.0]


def test_a_lift_off_lost_in_an_overflow_is_detected_by_reading_the_state(device):
    _, path, end = device(axes=SLOTTED, keys={kt.TOUCH}, slots={kt.ID: [-1], kt.MT_X: [0], kt.MT_Y: [0]})
    pad = Pad(path, end)
    pad.tick()
    pad.tick(kt.events(a(kt.ID, 7), a(kt.MT_X, 600), a(kt.MT_Y, 30), (1, kt.TOUCH, 1)))
    assert in_mm(pad.tick(kt.events((0, 3, 0)))) == ["lift"]


def test_queued_events_are_older_than_the_state(device):
    kernel, path, end = device(axes=SLOTTED, keys={kt.TOUCH}, slots={kt.ID: [-1], kt.MT_X: [0], kt.MT_Y: [0]})
    pad = Pad(path, end)
    pad.tick()
    kernel.pressed, kernel.slots = {kt.TOUCH}, {kt.ID: [7], kt.MT_X: [640], kt.MT_Y: [30]}
    flood = kt.events((0, 3, 0)) + b"".join(kt.events(a(kt.MT_X, 500 + i)) for i in range(100))
    assert in_mm(pad.tick(flood)) == [32.0]
    assert pad.port.read() == b""


def test_a_contact_that_exists_at_opening_is_reported(device):
    _, path, end = device(axes=SINGLE | {kt.X: (400, 0, 3000, 20)}, keys={kt.TOUCH}, pressed={kt.TOUCH})
    pad = Pad(path, end)
    pad.driver.tend(pad.port, 0.0)
    (report,) = pad.driver.reports(b"", 100.0)
    assert report.x_counts == 400


def test_a_protocol_a_device_keeps_its_contact_if_its_state_reports_a_touch(device):
    kernel, path, end = device(axes=PACKETED, keys={kt.TOUCH})
    pad = Pad(path, end)
    pad.tick()
    assert in_mm(pad.tick(kt.events(a(kt.MT_X, 600), a(kt.MT_Y, 30), (0, 2, 0), (1, kt.TOUCH, 1)))) == [30.0]
    kernel.pressed = {kt.TOUCH}
    assert pad.tick(kt.events((0, 3, 0))) == []
    assert in_mm(pad.tick(kt.events(a(kt.MT_X, 610), a(kt.MT_Y, 30), (0, 2, 0)))) == [30.5]
    kernel.pressed = set()
    assert in_mm(pad.tick(kt.events((0, 3, 0)))) == ["lift"]


@pytest.mark.parametrize(
    ("pressure", "config", "s_m", "force_n"),
    [
        ((0, 0, 4000, 2), {}, 0.025, 100 * 9.80665e-3),  # 20 units/mm, 100 g
        ((0, 0, 4000, 2), {"counts_per_mm": 25.0, "newtons_per_count": 0.01}, 0.020, 2.0),
        ((0, 0, 255, 0), {}, 0.025, None),
    ],
    ids=["of the device", "overridden by the configuration", "a pressure of unknown unit is no force"],
)
def test_units(device, pressure, config, s_m, force_n):
    _, path, end = device(axes=SINGLE | {kt.PRESSURE: pressure}, keys={kt.TOUCH})
    pad = Pad(path, end, **config)
    pad.tick()
    (sample,) = pad.tick(kt.events(a(kt.X, 500), a(kt.Y, 1), a(kt.PRESSURE, 200), (1, kt.TOUCH, 1)))
    assert (sample.s, sample.force) == (pytest.approx(s_m), force_n and pytest.approx(force_n))


def test_a_position_of_unknown_unit_is_reported_as_a_problem(device):
    _, path, end = device(axes={kt.X: (0, 0, 3000, 0), kt.Y: (0, 0, 3000, 0)}, keys={kt.TOUCH})
    pad = Pad(path, end)
    assert pad.tick(kt.events(a(kt.X, 500), a(kt.Y, 1), (1, kt.TOUCH, 1))) == []
    assert "set counts_per_mm" in pad.driver.diagnosis


TRACKPAD = {
    kt.X: (0, -3678, 3934, 47), kt.Y: (0, -2479, 2586, 44), kt.SLOT: (0, 0, 15, 0), kt.ID: (0, 0, 65535, 0),
    kt.MT_X: (0, -3678, 3934, 47), kt.MT_Y: (0, -2479, 2586, 44), kt.MT_PRESSURE: (0, 0, 2000, 4),
}  # fmt: skip
"""160 x 114.9 mm, as the driver of such a trackpad describes it; force in units per gram, as of Linux 6.18."""


def test_a_large_pressure_trackpad_has_a_resolution_of_0_02_mm_and_forces_of_each_touch(device):
    slots = {kt.ID: [-1] * 16, kt.MT_X: [0] * 16, kt.MT_Y: [0] * 16, kt.MT_PRESSURE: [0] * 16}
    _, path, end = device(axes=TRACKPAD, keys={kt.TOUCH}, slots=slots, properties={kt.PRESSUREPAD})
    pad = Pad(path, end, zero_mm=80.0, counts_per_mm=47.575)
    assert pad.tick() == []
    first = [a(kt.ID, 1), a(kt.MT_X, 100), a(kt.MT_Y, 0), a(kt.MT_PRESSURE, 408)]
    (one,) = pad.tick(kt.events(*first, (1, kt.TOUCH, 1)))
    assert one.force == pytest.approx(408 / 4 * 9.80665e-3), "102 g"
    (two,) = pad.tick(kt.events(a(kt.MT_X, 101), a(kt.SLOT, 1), a(kt.ID, 2), a(kt.MT_X, -900), a(kt.MT_PRESSURE, 1800)))
    assert (two.s - one.s) * 1e3 == pytest.approx(0.021, abs=0.001)
    assert two.force == one.force, "the first contact counts, with its own force"
    assert in_mm(pad.tick(kt.events(a(kt.ID, -1), a(kt.SLOT, 0), a(kt.ID, -1), (1, kt.TOUCH, 0)))) == ["lift"]


def test_a_reported_resolution_has_the_uncertainty_of_rounding(device):
    """47 for 47.575: the driver rounds to integers, and every length would be 1.2 % too long."""
    _, path, _ = device(axes=TRACKPAD, keys={kt.TOUCH}, properties={kt.PRESSUREPAD})
    found = inspect_pad(EvdevConfig(kind="evdev", port=path)).config
    assert found.counts_per_mm == 47.0
    assert 47.575 / 47.0 - 1.0 < 1.1 * found.scale_sd < 0.02
    for given in ({"counts_per_mm": 47.575}, {"scale_sd": 0.001}):
        assert inspect_pad(EvdevConfig(kind="evdev", port=path, **given)).config.scale_sd <= 0.003


def test_a_device_can_be_described_without_being_grabbed(device):
    kernel, path, _ = device(axes=SLOTTED, keys={kt.TOUCH}, properties={kt.PRESSUREPAD})
    found = query_device(path)
    assert (found.name, found.counts_per_mm("x"), found.is_pressure_pad) == ("a test pad", 20.0, True)
    assert kernel.grabbed == 0


def test_missing_units_are_filled_in_and_others_compared(device):
    _, path, _ = device(axes=SLOTTED | {kt.MT_PRESSURE: (0, 0, 255, 10)}, keys={kt.TOUCH})
    found = query_device(path)
    plain = EvdevConfig(kind="evdev", port=path)
    filled = with_reported_units(plain, found)
    assert (filled.counts_per_mm, filled.newtons_per_count) == (20.0, pytest.approx(9.80665e-4))
    assert list(contradictions(plain, found)) == []
    measured = EvdevConfig(kind="evdev", port=path, counts_per_mm=20.4, newtons_per_count=1e-3)
    assert list(contradictions(measured, found)) == []
    assert with_reported_units(measured, found) == measured
    wrong = EvdevConfig(kind="evdev", port=path, counts_per_mm=10.0, newtons_per_count=0.02)
    assert [key for key, _ in contradictions(wrong, found)] == ["counts_per_mm", "newtons_per_count"]


needs_uinput = pytest.mark.skipif(not kt.devices_can_be_made(), reason="/dev/uinput cannot be opened")


@pytest.fixture
def made():
    devices = []

    def make(*args, **values):
        devices.append(kt.KernelDevice(*args, **values))
        return devices[-1]

    yield make
    for each in devices:
        each.close()


@needs_uinput
def test_the_kernels_keyboard_and_mouse_are_refused_and_stay_usable(made):
    keyboard = made({}, keys={30, 31, 32})
    mouse = made({}, keys={kt.LEFT}, moves={0, 1})
    for each, says in ((keyboard, "a keyboard"), (mouse, "a mouse")):
        port = EvdevPort("pad1", each.path)
        assert not port.poll_open(0.0)
        assert says in port.error


@needs_uinput
def test_the_kernels_touch_device_is_read_correctly_after_an_overflow(made):
    axes = {kt.SLOT: (0, 4, 0), kt.ID: (0, 65535, 0), kt.MT_X: (0, 6000, 20), kt.MT_Y: (0, 4000, 20)}
    there = made(axes, keys={kt.TOUCH}, properties={0, kt.PRESSUREPAD})
    there.send(a(kt.ID, 7), a(kt.MT_X, 600), a(kt.MT_Y, 1300), (1, kt.TOUCH, 1))
    driver = make_pad(1, EvdevConfig(kind="evdev", port=there.path, axis="y", zero_mm=0.0, length_mm=300.0))
    port, t = driver.port(), 0.0
    assert port.poll_open(t), port.error
    assert port.device.is_pressure_pad
    driver.opened(t)

    def tick():
        nonlocal t
        t += 0.01
        driver.tend(port, 0.0)
        events = driver.feed(port.read(), t)
        driver.tend(port, 0.0)
        return in_mm([*events, *driver.poll(t)])

    assert tick() == [65.0], "touched before it was opened"
    for i in range(400):  # far more than the kernel's queue holds
        there.send(a(kt.MT_X, 700 + i))
    there.send(a(kt.SLOT, 1), a(kt.ID, 8), a(kt.MT_X, 3000), a(kt.MT_Y, 3100))
    seen = [place for _ in range(12) for place in tick()]
    assert driver.counts()["dropped"] >= 1
    assert set(seen) == {65.0}
    there.send(a(kt.ID, -1))
    there.send(a(kt.SLOT, 0), a(kt.ID, -1), (1, kt.TOUCH, 0))
    assert tick()[-1] == "lift"
    port.close()


@needs_uinput
def test_the_kernels_protocol_a_device_is_read_and_released(made):
    there = made({kt.MT_X: (0, 6000, 20), kt.MT_Y: (0, 4000, 20)})
    driver = make_pad(1, EvdevConfig(kind="evdev", port=there.path, zero_mm=0.0, length_mm=300.0))
    port = driver.port()
    assert port.poll_open(0.0), port.error
    driver.opened(0.0)
    driver.tend(port, 0.0)
    there.send(a(kt.MT_X, 600), a(kt.MT_Y, 30), (0, 2, 0))
    assert in_mm(driver.feed(port.read(), 1.0)) == [30.0]
    there.send((0, 2, 0))
    assert in_mm(driver.feed(port.read(), 1.1)) == ["lift"]
    port.close()
