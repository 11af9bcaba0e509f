"""Event logs: a run as JSON lines, the neutral form for import and export.

The first line describes the rig, each other line is one event at the time when it was true; see `read_log` for
what is forgiven. Truth, which simulators write beside the readings, never becomes an event.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from palmd.devices.pad import MARGIN_MM
from palmd.events import Event, Joints, PadSample, PalmSample
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, PadSensor, RigDescription
from palmd.system.mechanism import OPENING, PALMS

VERSION = 1
MAX_LINE_BYTES = 1 << 20
MAX_BACKWARD_S = 1.0  # an event that comes late is one thing, another run in the same file another
MAX_GAP_S = 600.0
_MAX_LENGTH_M = 1.0
_ANGLES, _RATES, _ACCELERATIONS = (
    [f"{what}{palm}_{unit}" for palm in PALMS]
    for what, unit in (("phi", "rad"), ("omega", "rad_s"), ("alpha", "rad_s2"))
)
_CURVATURE = "palm{}_curvature_per_m"

Line = dict[str, Any]


class LogError(Exception):
    """A log that cannot be used; its text is one line `file:line: what`."""


@dataclass(frozen=True, slots=True)
class EventLog:
    """A run: the rig, its events in the order of the file, and notes on what was left out of them."""

    rig: RigDescription
    events: tuple[Event, ...]
    notes: tuple[str, ...] = ()


class _BadLineError(ValueError):
    """What is wrong with one line; `read_log` says which."""


# ---------------------------------------------------------------------------------------------------- reading


def read_log(path: Path) -> EventLog:
    """Read an event log; raises LogError for the first thing that makes it unusable.

    Unknown keys and lines of an unknown kind are ignored, so are truth lines and readings that lie off the
    pad. A last line that was cut off is dropped with a note. Events may come late by `MAX_BACKWARD_S`; they
    keep the order of the file.
    """
    try:
        with path.open("rb") as stream:
            return _Reader(path).read(stream)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._number = 0  # of the line in hand
        self._latest = -math.inf
        self._off_pad = self._unknown = 0

    def read(self, stream: BinaryIO) -> EventLog:
        notes: list[str] = []
        events: list[Event] = []
        rig: RigDescription | None = None
        for raw in iter(lambda: stream.readline(MAX_LINE_BYTES + 1), b""):
            self._number += 1
            try:
                if raw.isspace():
                    continue
                line = _decoded(raw)
                if rig is None:
                    rig = _rig(line)
                    longest = [pad.length + MARGIN_MM * 1e-3 for pad in rig.pads]
                else:
                    events += self._events(line, longest)
            except _BadLineError as error:
                if rig is not None and not raw.endswith(b"\n") and len(raw) <= MAX_LINE_BYTES:
                    notes.append(f"{self._path}:{self._number}: the last line was cut off and is left out")
                    break
                raise LogError(f"{self._path}:{self._number}: {error}") from None
        if rig is None:
            raise LogError(f"{self._path}:1: the file is empty; an event log begins with its palmd_log line")
        if not events:
            raise LogError(f"{self._path}:{self._number}: the log holds no events")
        for count, what in ((self._off_pad, "readings off the pad"), (self._unknown, "lines of an unknown kind")):
            if count:
                notes.append(f"{self._path}: {count} {what} left out")
        return EventLog(rig, tuple(events), tuple(notes))

    def _events(self, line: Line, longest: Sequence[float]) -> Iterator[Event]:
        if "truth" in line:
            return
        if "pad" not in line and "palms" not in line:
            self._unknown += 1
            return
        t = _number(line, "t")
        self._check_order(t)
        if "pad" in line:
            sample = _pad_sample(t, line)
            if 0.0 < sample.s <= longest[sample.pad - 1]:
                yield sample
            else:
                self._off_pad += 1
        if "palms" in line:
            yield _palm_sample(t, _block(line, "palms"))

    def _check_order(self, t: float) -> None:
        latest = self._latest
        if t < latest - MAX_BACKWARD_S:
            raise _BadLineError(f"time runs backwards by {latest - t:g} s; is this more than one run?")
        if t > latest + MAX_GAP_S and math.isfinite(latest):
            raise _BadLineError(f"time jumps by {t - latest:g} s; t is in seconds, and a log holds one run")
        self._latest = max(t, latest)


def _decoded(raw: bytes) -> Line:
    if len(raw) > MAX_LINE_BYTES:
        raise _BadLineError(f"the line is longer than {MAX_LINE_BYTES} bytes; an event log has one event a line")
    try:
        line = json.loads(raw.decode())
    except UnicodeDecodeError:
        raise _BadLineError("not text (UTF-8)") from None
    except (ValueError, RecursionError) as error:
        what = error.msg if isinstance(error, json.JSONDecodeError) else "numbers or nesting beyond reason"
        raise _BadLineError(f"not JSON: {what}") from None
    if not isinstance(line, dict):
        raise _BadLineError(f"must be an object {{…}}, got {_shown(line)}")
    return line


def _pad_sample(t: float, line: Line) -> PadSample:
    pad = line["pad"]
    if type(pad) is not int or pad not in PALMS:
        raise _BadLineError(f"pad must be {' or '.join(map(str, PALMS))}, got {_shown(pad)}")
    s = _number(line, "s_m")
    if abs(s) > _MAX_LENGTH_M:
        raise _BadLineError(f"s_m is {s:g}, which is no place on a palm; it is in metres")
    return PadSample(t, pad, s, _optional(line, "force_n"))


def _palm_sample(t: float, palms: Line) -> PalmSample:
    angles = tuple(_number(palms, name) for name in _ANGLES)
    for name, angle in zip(_ANGLES, angles, strict=True):
        if name == _ANGLES[OPENING] and not 0.0 < angle < math.pi:
            raise _BadLineError(f"{name} is {angle:g}; the angle between the palms lies between 0 and pi")
        if abs(angle) > math.tau:
            raise _BadLineError(f"{name} is {angle:g}, more than a full turn; it is in radians")
    return PalmSample(t, angles, _joints(palms, _RATES), _joints(palms, _ACCELERATIONS))


def _joints(palms: Line, names: Sequence[str]) -> Joints | None:
    """The plan's values of all joints, None where one is missing."""
    told = [_optional(palms, name) for name in names]
    known = tuple(value for value in told if value is not None)
    return known if len(known) == len(names) else None


def _rig(line: Line) -> RigDescription:
    """The header's rig. For an arc hinge the fixed end B lies at (L1, 0), so that O = 0 where φ1 = 0."""
    if "palmd_log" not in line:
        raise _BadLineError('the first line must be the header {"palmd_log":1,"rig":{…}}')
    if line["palmd_log"] != VERSION or type(line["palmd_log"]) is not int:
        raise _BadLineError(f"palmd_log is {_shown(line['palmd_log'])}; this palmd reads version {VERSION}")
    rig = _block(line, "rig")
    hinge, default = _block(rig, "hinge"), RigDescription()
    mode = hinge.get("mode")
    if mode not in ("fixed", "arc"):
        raise _BadLineError(f"hinge.mode must be fixed or arc, got {_shown(mode)}")
    length = _positive(hinge, "palm1_length_m") if mode == "arc" else default.palm1_length
    sds = _sds(rig, _default_sds(rig))
    common = _sensor(rig, _block(rig, "pad"), PadSensor())
    curvatures = [_curvature(rig, palm, common.length) for palm in PALMS]
    described = RigDescription(
        gravity=_positive(rig, "gravity_m_s2"),
        hinge=mode,
        palm1_length=length,
        base=(length, 0.0),
        palm_angle_noise=_positive(rig, "palm_angle_noise_rad", default.palm_angle_noise),
        pads=tuple(replace(common, curvature=kappa) for kappa in curvatures),
    ).known_to(sds)
    own = rig.get("pads")
    if own is None:
        return described
    if not isinstance(own, list) or len(own) != len(PALMS) or not all(isinstance(each, dict) for each in own):
        raise _BadLineError(f"pads must be a list of {len(PALMS)} objects, one for each palm")
    return replace(described, pads=tuple(map(_own_sensor, own, described.pads)))


def _curvature(rig: Line, palm: int, length: float) -> float:
    """A palm's (1/m), 0 where the log says nothing."""
    key = _CURVATURE.format(palm)
    curvature = _number(rig, key) if rig.get(key) is not None else 0.0
    if abs(curvature) * length > math.pi / 2:
        radius = f"a radius of {1e3 / abs(curvature):.3g} mm"
        raise _BadLineError(f"{key} is {curvature:g}, {radius}, which bends the pad by more than a quarter turn")
    return curvature


def _sensor(line: Line, pad: Line, default: PadSensor) -> PadSensor:
    """A pad's sensor, its reach and noise from the block `pad`, the rest from `line`."""
    return replace(
        default,
        length=_positive(pad, "length_m"),
        noise=_positive(pad, "noise_m"),
        resolution=_not_negative(pad, "resolution_m"),
        force_scale_std=_positive(line, "force_scale_std"),
        force_gain_std=_not_negative(line, "force_gain_std", default.force_gain_std),
        force_resolution=_not_negative(line, "force_resolution_n", default.force_resolution),
    )


def _default_sds(rig: Line) -> Mapping[str, float]:
    """What goes for constants of which the log says nothing: as calibrated, or known if all that it names are.

    How alike the palms rub is no matter of calibration: whoever means it says so by name.
    """
    told = [sd for sd in _calibration_sd(rig).values() if sd is not None]
    if not told or any(told):
        return AS_CALIBRATED
    return dict.fromkeys(AS_CALIBRATED, 0.0) | {"friction_sd": AS_CALIBRATED["friction_sd"]}


def _own_sensor(line: Line, common: PadSensor) -> PadSensor:
    """What one entry of `pads` says of its pad; how well its constants are known is as of all where left out."""
    own = _sensor(line, line, common)
    of_pad = {name: getattr(common, name) for name in CALIBRATION_KEYS if hasattr(common, name)}
    return replace(own, **_sds(line, of_pad))


def _sds(line: Line, default: Mapping[str, float]) -> dict[str, float]:
    """How well constants are known; what `line` does not say is as in `default`."""
    told = _calibration_sd(line)
    return {name: _not_negative(told, CALIBRATION_KEYS[name], each) for name, each in default.items()}


def _calibration_sd(line: Line) -> Line:
    return {} if line.get("calibration_sd") is None else _block(line, "calibration_sd")


def _block(line: Line, key: str) -> Line:
    value = line.get(key)
    if not isinstance(value, dict):
        raise _BadLineError(f"{key} is missing" if value is None else f"{key} must be an object {{…}}")
    return value


def _number(line: Line, key: str) -> float:
    value = line.get(key)
    if (type(value) is float or type(value) is int) and abs(value) < math.inf:
        try:
            return float(value)
        except OverflowError:
            pass
    if key not in line:
        raise _BadLineError(f"{key} is missing")
    raise _BadLineError(f"{key} must be a finite number, got {_shown(value)}")


def _optional(line: Line, key: str) -> float | None:
    return None if line.get(key) is None else _number(line, key)


def _positive(line: Line, key: str, default: float | None = None) -> float:
    return _bounded(line, key, default, lambda value: value > 0.0, "more than 0")


def _not_negative(line: Line, key: str, default: float | None = None) -> float:
    return _bounded(line, key, default, lambda value: value >= 0.0, "at least 0")


def _bounded(line: Line, key: str, default: float | None, allowed: Callable[[float], bool], bound: str) -> float:
    if default is not None and line.get(key) is None:
        return default
    value = _number(line, key)
    if not allowed(value):
        raise _BadLineError(f"{key} must be {bound}, got {value:g}")
    return value


def _shown(value: object) -> str:
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = json.dumps(value) if not isinstance(value, int) or abs(value) < 10**20 else "a number beyond reason"
    return text if len(text) <= 40 else text[:37] + "…"


# ---------------------------------------------------------------------------------------------------- writing


def write_log(stream: TextIO, rig: RigDescription, events: Iterable[Event]) -> None:
    """Write a run as an event log; a `PadLift` has no form there and shows as the silence that follows it."""
    for line in (header_line(rig), *filter(None, map(event_line, events))):
        stream.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")


def header_line(rig: RigDescription) -> Line:
    """The first line of a log. Where an arc hinge's fixed end lies is not told: logs put it at (L1, 0).

    Where the pads differ, `pads` has each one's own and the rest the worse of both, for readers that take them alike.
    """
    hinge: Line = {"mode": rig.hinge}
    if rig.hinge == "arc":
        hinge["palm1_length_m"] = rig.palm1_length
    pads = [_pad_line(pad) for pad in rig.pads]
    worst = {key: (min if key == "length_m" else max)(pad[key] for pad in pads) for key in pads[0]}
    sds = {key: _told_sd(rig, name) for name, key in CALIBRATION_KEYS.items()}
    described: Line = {
        "gravity_m_s2": rig.gravity,
        "hinge": hinge,
        "pad": {key: worst.pop(key) for key in ("length_m", "noise_m", "resolution_m")},
        "force_scale_std": worst.pop("force_scale_std"),
        "force_gain_std": worst.pop("force_gain_std"),
        "palm_angle_noise_rad": rig.palm_angle_noise,
        **worst,
        "calibration_sd": sds,
        **{_CURVATURE.format(palm): kappa for palm, kappa in zip(PALMS, rig.curvatures, strict=True) if kappa},
    }
    if any(replace(pad, curvature=rig.pads[0].curvature) != rig.pads[0] for pad in rig.pads):
        of_pad = {name: key for name, key in CALIBRATION_KEYS.items() if hasattr(rig.pads[0], name)}
        described["pads"] = [
            line | {"calibration_sd": {key: getattr(pad, name) for name, key in of_pad.items()}}
            for line, pad in zip(pads, rig.pads, strict=True)
        ]
    return {"palmd_log": VERSION, "rig": described}


def _pad_line(pad: PadSensor) -> Line:
    return {
        "length_m": pad.length,
        "noise_m": pad.noise,
        "resolution_m": pad.resolution,
        "force_scale_std": pad.force_scale_std,
        "force_gain_std": pad.force_gain_std,
        "force_resolution_n": pad.force_resolution,
    }


def _told_sd(rig: RigDescription, name: str) -> float:
    """How well the rig's constant is known; the worse one where it is each pad's own."""
    return float(getattr(rig, name)) if hasattr(rig, name) else max(getattr(pad, name) for pad in rig.pads)


def event_line(event: Event) -> Line | None:
    """One event as a line; None for what has no form there."""
    if isinstance(event, PadSample):
        fields = {"pad": event.pad, "s_m": event.s, "force_n": event.force}
        return {"t": event.t_sample} | _told(fields)
    if isinstance(event, PalmSample):
        told = ((_ANGLES, event.angles), (_RATES, event.rates), (_ACCELERATIONS, event.accelerations))
        palms = {name: value for names, values in told for name, value in zip(names, values or (), strict=False)}
        return {"t": event.t_sample, "palms": palms}
    return None


def _told(fields: Line) -> Line:
    return {name: value for name, value in fields.items() if value is not None}
