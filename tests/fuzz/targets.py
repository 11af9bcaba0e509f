"""Each reader of external data as a function of bytes that must not raise, whatever the bytes.

A target uses the bytes as the programs do, catches the errors that its reader documents, and checks further invariants.
`tools/fuzz.py` searches for bytes that break one; the tests run the stored ones and some random ones.
"""

import contextlib
import json
import math
import tempfile
from pathlib import Path

import msgpack
import numpy as np
from websockets.datastructures import Headers
from websockets.exceptions import InvalidHeaderValue
from websockets.http11 import Request

from palmd.config.arms import AdeptConfig
from palmd.config.pads import TaxelsConfig, VersaPadConfig
from palmd.config.two_palms import Config, PlanSpec
from palmd.daemon.commands import COMMANDS, CommandError, Reply, parse, reply_fields
from palmd.devices.actuator import make_actuator
from palmd.devices.armhost import ArmHost
from palmd.devices.armlink import Hello, LineReader, LinkError, command_body, encode_command, parse_command, parse_reply
from palmd.devices.armlink import reply_body as body_of
from palmd.devices.pad import make_pad
from palmd.devices.versapad import VersaPadDecoder
from palmd.events import PadSample
from palmd.motion.check import motion_limits
from palmd.motion.plan import PlanError, compile_plan
from palmd.record import RunError
from palmd.record.eventlog import LogError, read_log
from palmd.record.mcapread import is_packed
from palmd.record.run import read_run
from palmd.record.runfile import pack
from palmd.rig.adept_arm import arm_limits
from palmd.rig.arm import Linkage
from palmd.rig.controller import Controller
from palmd.rig.servos import make_servo_arm
from palmd.rig.world import default_config
from palmd.view import http_guard, wire
from palmd.view.http_guard import File
from palmd.yamlfile import ConfigError, load_config, load_plan

BAUD = 9600
_CONFIG = default_config()
_LIMITS = motion_limits(_CONFIG)
_ARM = arm_limits(_CONFIG)
_HOME = Linkage.from_config(_CONFIG).pose(math.radians(45.0), math.radians(90.0))
_ARRAYS = tuple(
    TaxelsConfig.model_validate({"kind": "taxels", "port": "a", "zero_mm": 1.0, "columns": 4} | each)
    for each in (
        {"protocol": "tsf85", "rows": 14, "pitch_mm": 4.5},
        {"protocol": "st0001", "rows": 15, "pitch_mm": 4.0},
        {"protocol": "text", "rows": 20, "pitch_mm": 3.0},
    )
)
_SERVOS = tuple(
    Config.model_validate(
        {
            "rig": {"hinge": "fixed"},
            "pads": {f"palm{i}": {"kind": "strip", "port": f"{i}"} for i in (1, 2)},
            "arm": {"kind": kind, "port": "c"},
        }
    )
    for kind in ("dynamixel", "feetech")
)
_FOLDER = tempfile.TemporaryDirectory(prefix="palmd-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None)
_FILES = {"/": File(b"page", "text/html")}
_TOKEN = "the token"


def _pieces(data: bytes) -> list[bytes]:
    """Splits the data into pieces of a length given by the first byte."""
    size = max(1, data[0] if data else 1)
    return [data[at : at + size] for at in range(1, len(data), size)]


def _file(data: bytes) -> Path:
    path = Path(_FOLDER.name) / "file"
    path.write_bytes(data)
    return path


def versapad(data: bytes) -> None:
    """A pad's line: every byte is counted, times do not decrease, contacts lie on the pad."""
    decoder, driver, t, latest = VersaPadDecoder(BAUD), make_pad(1, VersaPadConfig(port="a")), 0.0, -math.inf
    for piece in _pieces(data):
        t += (piece[0] % 8) * 0.01
        for packet in decoder.feed(piece, t):
            assert latest <= packet.t_first <= t
            assert -2048 <= min(packet.x_counts, packet.y_counts) <= max(packet.x_counts, packet.y_counts) <= 2047
            assert 0 <= packet.pressure <= 127
            latest = packet.t_first
        counters = decoder.counters
        assert counters.bytes == 6 * counters.packets + counters.discarded + decoder.pending
        for event in driver.feed(piece, t):
            assert event.t_sample <= t
            assert not isinstance(event, PadSample) or 0.0 < event.s <= 0.0565
        driver.poll(t)


def taxels(data: bytes) -> None:
    """An array's line: every byte is counted, times do not decrease, contacts lie on the array."""
    driver = make_pad(1, _ARRAYS[(data[0] if data else 0) % len(_ARRAYS)])
    driver.opened(0.0)
    t, latest, size = 0.0, -math.inf, 0
    for piece in _pieces(data):
        t += (piece[0] % 8) * 0.005
        size += len(piece)
        for event in driver.feed(piece, t):
            assert latest <= event.t_sample <= t
            latest = event.t_sample
            assert not isinstance(event, PadSample) or 0.0 < event.s <= 0.0565
        driver.poll(t)
        driver.tend(_Nobody(), t)
    counts = driver.counts()
    assert counts["bytes"] == size
    assert counts["discarded"] <= size


_POLLS = 10  # after which a host waits for an answer


class _Nobody:
    """A line for a driver to write to, without a reader."""

    def write(self, data: bytes) -> None:
        assert isinstance(data, bytes)


def servos(data: bytes) -> None:
    """A bus of servos of one make: host and servos accept anything."""
    config = _SERVOS[(data[0] if data else 0) % len(_SERVOS)]
    host, t = make_actuator(config.arm), 0.0
    far = make_servo_arm(config, config.arm, (0.8, 1.5), np.random.default_rng(1), t)
    for piece in _pieces(data):
        t += (piece[0] % 8) * 0.005
        host.feed(piece, t)
        far.receive(piece, piece, t)
        for _ in range(_POLLS):
            sent = host.poll(t, None).data
            far.receive(sent, sent, t)
            if host.due() > t:
                break
        else:
            raise AssertionError(f"the host never becomes idle at {t} s")
        for said in far.step(t + 0.002):
            host.feed(said.data, t)
        list(host.health(True))


def armlink(data: bytes) -> None:
    """Grammar of both directions: a decoded line is encoded and decoded to the same value."""
    for line in LineReader(BAUD).feed(data, 0.0):
        _read_again(line.body)
    _read_again(data.decode("ascii", "replace"))


def _read_again(body: str) -> None:
    with contextlib.suppress(LinkError):
        command = parse_command(body)
        assert parse_command(command_body(command)) == command
    with contextlib.suppress(LinkError):
        reply = parse_reply(body)
        assert parse_reply(body_of(reply)) == reply


def armhost(data: bytes) -> None:
    """The host accepts anything on an open link and continues: it writes only commands."""
    host, t = ArmHost(AdeptConfig(port="a", baud=BAUD)), 0.0
    assert host.poll(t, None).data == encode_command(Hello())
    wanted = (host.request_tracking, host.request_stop, host.request_reset)
    for number, piece in enumerate(_pieces(data)):
        t += (piece[0] % 8) * 0.004
        for report in host.feed(piece, t):
            assert report.t_sample <= t
        if number % 4 == 3:
            wanted[piece[0] % 3]()
        for line in LineReader(BAUD).feed(host.poll(t, _HOME).data, t):
            parse_command(line.body)
        assert host.due() > -math.inf or host.hello is None


def controller(data: bytes) -> None:
    """The emulated controller accepts anything: it sends replies, and its path stays in the workspace."""
    machine, t = Controller(_ARM, _HOME, BAUD, lambda _pose, _t: None), 0.0
    for piece in _pieces(data):
        t += 0.016
        said = machine.feed(piece, t, machine.path) + machine.cycle(t, machine.path)
        for line in LineReader(BAUD).feed(said, t):
            parse_reply(line.body)
        assert _ARM.contain(machine.path)


def commands(data: bytes) -> None:
    """The command socket: a request of the table, or an error that can be sent to its client."""
    try:
        request = parse(data, (b"route",))
    except CommandError as error:
        msgpack.packb(reply_fields(error.id, str(error)))
        return
    assert request.name in COMMANDS
    known = {argument.name: argument for argument in COMMANDS[request.name].arguments}
    for name, value in request.args.items():
        assert isinstance(value, str if known[name].kind == "text" else int | float)
    msgpack.packb(Reply(request, None, {}).fields())


def config(data: bytes) -> None:
    """A configuration: a complete one, or errors with their places."""
    path = _file(data)
    try:
        assert isinstance(load_config(path), Config)
    except ConfigError as error:
        _check_places(path, error)


def plan(data: bytes) -> None:
    """A plan: a trajectory within the limits, or errors with their places."""
    path = _file(data)
    try:
        spec = load_plan(path)
    except ConfigError as error:
        _check_places(path, error)
        return
    assert isinstance(spec, PlanSpec)
    with contextlib.suppress(PlanError):
        trajectory = compile_plan(spec, _LIMITS)
        for tau in (0.0, 0.3, 0.5 * min(trajectory.duration, 100.0), min(trajectory.duration, 1e4)):
            motion = trajectory.at(tau)
            assert not _LIMITS.violations(motion.angles)


def _check_places(path: Path, error: ConfigError) -> None:
    assert error.errors
    for line in error.errors:
        _check_line(path, line)
        row, column, _ = line.removeprefix(f"{path}:").split(":", 2)
        assert min(int(row), int(column)) > 0


def _check_line(path: Path, text: str) -> None:
    assert text.startswith(f"{path}:")
    assert len(text.splitlines()) == 1


def eventlog(data: bytes) -> None:
    """An event log: finite events, or a one-line error."""
    path = _file(data)
    try:
        log = read_log(path)
    except LogError as error:
        _check_line(path, str(error))
        return
    assert all(math.isfinite(event.t_sample) for event in log.events)


def mcap(data: bytes) -> None:
    """A recording: its intact messages, or a one-line error; packed, it holds the same."""
    path = _file(data)
    with contextlib.suppress(RunError):
        is_packed(path)
    with contextlib.suppress(RunError):
        run = read_run(path)
        messages = [(message.topic, message.payload) for message in run.messages()]
        for read in (run.survey, lambda: list(run.events()), lambda: list(run.improvements()), run.event_log):
            with contextlib.suppress(RunError):
                read()
        packed = path.with_name("packed")
        pack(path, packed)
        assert [(message.topic, message.payload) for message in read_run(packed).messages()] == messages


def page(data: bytes) -> None:
    """The page's entrance: a request is answered, a message is a token, a command or ignored."""
    path, host, origin, message = [*data.split(b"\n", 3), b"", b"", b""][:4]
    try:
        headers = Headers([("Host", host.decode("latin-1")), ("Origin", origin.decode("latin-1"))])
    except InvalidHeaderValue:  # websockets itself rejects such a request
        return
    answer = http_guard.answer(Request(path.decode("latin-1"), headers), _FILES)
    assert answer is None or answer.status_code in (200, 403, 404)
    for said in (message, message.decode("utf-8", "replace")):
        assert not http_guard.may_operate(wire.token_in(said), _TOKEN) or json.loads(said) == {"token": _TOKEN}
        order = wire.order_in(said)
        if order is not None:
            json.loads(wire.answer(order, "refused"))


TARGETS = {
    target.__name__: target
    for target in (versapad, taxels, servos, armlink, armhost, controller, commands, config, plan, eventlog, mcap, page)
}
