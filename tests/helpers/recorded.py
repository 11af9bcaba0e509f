"""A small recorded run without a daemon: messages of two ticks a line, as they are published."""

import math
from datetime import UTC, datetime

import msgpack

from palmd.config.two_palms import Config
from palmd.events import PadLift, PadSample, PalmSample
from palmd.messages import events_fields, info_fields, stamp
from palmd.quantities import EVENTS, INFO, LOOP
from palmd.record.mcapfile import RawMessage, RunWriter
from palmd.record.metadata import preface
from palmd.record.runfile import RunFile
from palmd.rig.world import default_config

BEGIN = datetime(2026, 11, 21, 22, 30, 5, tzinfo=UTC)
T0 = BEGIN.timestamp()


def config(folder):
    """A configuration whose recordings go to `folder`."""
    pads = {"palm1": {"port": "a"}, "palm2": {"port": "b"}}
    values = {"pads": pads, "arm": {"port": "c"}, "record": {"directory": str(folder)}}
    return Config.model_validate(values)


def events(number):
    """Events of one tick for the observer: one of each kind; none in the third tick."""
    t = 0.1 * number + 1 / 3
    pads = [PadSample(t, 1, 0.02 / 3, 0.5), PadSample(t, 2, 0.03, None), PadLift(t + 1e-3, 2)]
    palms = [PalmSample(t + 2e-3, (0.5, 1.5), None, (-0.2, math.pi)), PalmSample(t + 3e-3, (0.5, 1.5))]
    return [] if number == 3 else pads + palms


def message(topic, fields, number, t=0.0):
    """A message as the recorder stores it; `t` is Unix time after `T0` (s)."""
    payload = msgpack.packb(stamp(fields, T0 + t, t, number))
    return RawMessage(topic, round((T0 + t + 1e-3) * 1e9), round((T0 + t) * 1e9), number, payload)


def messages(ticks):
    """Messages of some ticks of a daemon, and a rig's truth, which has no table."""
    for i in range(ticks):
        yield message(EVENTS.name, events_fields(0.1 * i, events(i)), i, 0.1 * i)
        yield message("rig/truth", {"psi_rad": 0.1 * i}, 100 + i, 0.1 * i)
    yield message(LOOP.name, {"pad1_bytes": 3, "ticks": ticks}, 0, 0.1 * ticks)
    yield message(INFO.name, info_fields("0.1.0", "shape", default_config()), 0, 0.1 * ticks)


def begun(folder, ticks=5):
    """An unfinished run: the file, and the end position of each message's record."""
    file = RunFile(folder, preface(config(folder), BEGIN.isoformat()), BEGIN)
    ends = []
    for each in messages(ticks):
        file.write(each)
        file.flush()
        ends.append(file.size_bytes)
    return file, ends


def frames(topic, fields, number, t=0.0):
    """A message as frames on the bus."""
    raw = message(topic, fields, number, t)
    return [topic.encode(), raw.payload, b"%.6f" % (T0 + t)]


def written(path, some, preface, *, compressed=False, finish=True):
    """Writes a file of these messages; returns its path."""
    with path.open("wb") as stream:
        writer = RunWriter(stream, preface, 0, compressed=compressed)
        for one in some:
            writer.write(one)
        if finish:
            writer.finish()
    return path
