"""Event logs of two palms on a hinge: a run as JSON lines, the neutral format for import and export.

The first line describes the rig; each other line is one event with its sample time. `logreader` says which defects are
tolerated, `systems` reads the logs of other systems. Ground truth that simulators write between the readings is not an
event.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from palmd.devices.pad import MARGIN_MM
from palmd.events import Event, Joints, PadSample, PalmSample
from palmd.record.logline import (
    BadLineError,
    Line,
    block,
    not_negative,
    number,
    optional,
    positive,
    read_vibration,
    shown,
)
from palmd.record.logreader import VERSION, LogParser, read_log_as
from palmd.record.logreader import LogError as LogError
from palmd.system.corrections import corrections, fault_of
from palmd.system.description import AS_CALIBRATED, CALIBRATION_KEYS, MAP_SD_M, PadSensor, RigDescription
from palmd.system.mechanism import OPENING, PALMS
from palmd.system.vibration import vibration_line

_MAX_LENGTH_M = 1.0
_ANGLES, _RATES, _ACCELERATIONS = (
    [f"{what}{palm}_{unit}" for palm in PALMS]
    for what, unit in (("phi", "rad"), ("omega", "rad_s"), ("alpha", "rad_s2"))
)
_CURVATURE = "palm{}_curvature_per_m"
Map = tuple[tuple[float, float], ...]
MAP_LENGTH = "map_length_m"  # key in `calibration_sd`: correlation length of the pads' smooth position error


@dataclass(frozen=True, slots=True)
class EventLog:
    """A run: the rig, its events in file order, and notes on omitted lines."""

    rig: RigDescription
    events: tuple[Event, ...]
    notes: tuple[str, ...] = ()


# ---------------------------------------------------------------------------------------------------- reading


def read_log(path: Path) -> EventLog:
    """Read an event log of two palms on a hinge, as `read_log_as` does; raises LogError, also for other systems."""
    log: EventLog = read_log_as(path, _two_palms)[1]
    return log


FULL_SCALE_COUNTS = 127
"""Full scale of a pad's 7-bit pressure; a log does not state it otherwise."""

MIN_FULL_SCALE_READINGS = 3
"""Number of readings at the last count that show a pad at full scale; fewer may be chance."""


def _two_palms(system: str | None) -> LogParser:
    if system is None:
        return TwoPalmsLogParser()
    raise BadLineError(
        f"rig.system is {shown(system)}; this command needs a log of two palms on a hinge, which has no rig.system"
    )


class TwoPalmsLogParser:
    """Parser for logs of two palms on a hinge."""

    kinds = ("pad", "palms")

    def __init__(self) -> None:
        """Readings are not corrected until a header with pad maps has been read."""
        self._maps: Sequence[Map] = ((),) * len(PALMS)

    def rig(self, line: Line) -> RigDescription:
        """Parse the rig from the header. For an arc hinge the fixed end B lies at (L1, 0), so O = 0 where φ1 = 0."""
        described = _rig(line)
        self._maps = [_map(each) for each in _own_pads(line)] or self._maps
        return described

    def events(self, t: float, line: Line, rig: RigDescription) -> Iterator[Event | None]:
        """Yield the pad reading, the palm angles, or both; None for a reading off the pad."""
        if "pad" in line:
            sample = self._corrected(_pad_sample(t, line))
            yield sample if 0.0 < sample.s <= rig.pads[sample.pad - 1].length + MARGIN_MM * 1e-3 else None
        if "palms" in line:
            yield _palm_sample(t, block(line, "palms"))

    def _corrected(self, sample: PadSample) -> PadSample:
        points = self._maps[sample.pad - 1]
        return replace(sample, s=sample.s + float(corrections(points, [sample.s])[0])) if points else sample

    def log(self, rig: RigDescription, events: tuple[Event, ...], notes: tuple[str, ...]) -> EventLog:
        """Build the log from rig, events and notes."""
        return EventLog(rig, _censored(events, rig), notes)


def _pad_sample(t: float, line: Line) -> PadSample:
    pad = line["pad"]
    if type(pad) is not int or pad not in PALMS:
        raise BadLineError(f"pad must be {' or '.join(map(str, PALMS))}, got {shown(pad)}")
    s = number(line, "s_m")
    if abs(s) > _MAX_LENGTH_M:
        raise BadLineError(f"s_m is {s:g}, not a position on a palm; the unit is metres")
    return PadSample(t, pad, s, optional(line, "force_n"))


def _censored(events: tuple[Event, ...], rig: RigDescription) -> tuple[Event, ...]:
    """Mark readings at a pad's full scale as censored: a lower bound (`at_least`) instead of a force.

    A pressure has 127 counts. If a log's largest forces lie exactly on that count, the pad was saturated.
    """
    found = {}
    for pad, sensor in enumerate(rig.pads, 1):
        forces = [e.force for e in events if isinstance(e, PadSample) and e.pad == pad and e.force is not None]
        full, half = FULL_SCALE_COUNTS * sensor.force_resolution, 0.5 * sensor.force_resolution
        at_full = sum(force > full - half for force in forces)
        if half > 0.0 and at_full >= MIN_FULL_SCALE_READINGS and max(forces) <= full + half:
            found[pad] = full, full - half
    if not found:
        return events
    return tuple(
        replace(e, force=None, at_least=found[e.pad][0])
        if isinstance(e, PadSample) and e.pad in found and e.force is not None and e.force > found[e.pad][1]
        else e
        for e in events
    )


def _palm_sample(t: float, palms: Line) -> PalmSample:
    angles = tuple(number(palms, name) for name in _ANGLES)
    for name, angle in zip(_ANGLES, angles, strict=True):
        if name == _ANGLES[OPENING] and not 0.0 < angle < math.pi:
            raise BadLineError(f"{name} is {angle:g}; the angle between the palms lies between 0 and pi")
        if abs(angle) > math.tau:
            raise BadLineError(f"{name} is {angle:g}, more than a full turn; the unit is radians")
    return PalmSample(t, angles, _joints(palms, _RATES), _joints(palms, _ACCELERATIONS))


def _joints(palms: Line, names: Sequence[str]) -> Joints | None:
    """The commanded values of all joints; None if one is missing."""
    values = [optional(palms, name) for name in names]
    known = tuple(value for value in values if value is not None)
    return known if len(known) == len(names) else None


def _rig(rig: Line) -> RigDescription:
    hinge, default = block(rig, "hinge"), RigDescription()
    mode = hinge.get("mode")
    if mode not in ("fixed", "arc"):
        raise BadLineError(f"hinge.mode must be fixed or arc, got {shown(mode)}")
    length = positive(hinge, "palm1_length_m") if mode == "arc" else default.palm1_length
    sds = calibration_sds(rig)
    common = _sensor(rig, block(rig, "pad"), PadSensor(map_sd=0.0 if _exact(rig) else MAP_SD_M))
    curvatures = [_curvature(rig, palm, common.length) for palm in PALMS]
    described = RigDescription(
        gravity=positive(rig, "gravity_m_s2"),
        hinge=mode,
        palm1_length=length,
        base=(length, 0.0),
        palm_angle_noise=positive(rig, "palm_angle_noise_rad", default.palm_angle_noise),
        goal_rounding=not_negative(rig, "goal_rounding_rad", 0.0),
        pads=tuple(replace(common, curvature=kappa) for kappa in curvatures),
        vibration=read_vibration(rig),
    ).known_to(sds)
    own = _own_pads(rig)
    return replace(described, pads=tuple(map(_own_sensor, own, described.pads))) if own else described


def _own_pads(rig: Line) -> list[Line]:
    """The per-pad entries of the header (`pads`); empty if the pads are identical."""
    own = rig.get("pads")
    if own is None:
        return []
    if not isinstance(own, list) or len(own) != len(PALMS) or not all(isinstance(each, dict) for each in own):
        raise BadLineError(f"pads must be a list of {len(PALMS)} objects, one for each palm")
    return own


def _map(pad: Line) -> Map:
    """A pad's map from position to correction (m), given as pairs in mm; empty if it has none."""
    points = pad.get("map")
    if points is None:
        return ()
    pairs = isinstance(points, list) and all(
        isinstance(point, list) and len(point) == 2 and all(type(value) in (int, float) for value in point)
        for point in points
    )
    fault = fault_of(points) if pairs else "must be a list of pairs [place_mm, correction_mm]"
    if fault:
        raise BadLineError(f"map {fault}; got {shown(points)}")
    return tuple((1e-3 * place, 1e-3 * correction) for place, correction in points)


def _curvature(rig: Line, palm: int, length: float) -> float:
    """A palm's curvature (1/m); 0 if the log does not give it."""
    key = _CURVATURE.format(palm)
    curvature = number(rig, key) if rig.get(key) is not None else 0.0
    if abs(curvature) * length > math.pi / 2:
        radius = f"a radius of {1e3 / abs(curvature):.3g} mm"
        raise BadLineError(f"{key} is {curvature:g}, {radius}: the pad would bend by more than a quarter turn")
    return curvature


def _sensor(line: Line, pad: Line, default: PadSensor) -> PadSensor:
    """A pad's sensor: length, noise and resolution from the block `pad`, the rest from `line`."""
    known = _calibration_sd(line)
    return replace(
        default,
        length=positive(pad, "length_m"),
        noise=positive(pad, "noise_m"),
        resolution=not_negative(pad, "resolution_m"),
        force_scale_std=positive(line, "force_scale_std"),
        force_gain_std=not_negative(line, "force_gain_std", default.force_gain_std),
        force_resolution=not_negative(line, "force_resolution_n", default.force_resolution),
        map_sd=not_negative(known, CALIBRATION_KEYS["map_sd"], default.map_sd),
        map_length=positive(known, MAP_LENGTH, default.map_length),
    )


def calibration_sds(rig: Line) -> dict[str, float]:
    """Standard deviations of the rig's constants.

    Those that the log does not name are 0 if it gives 0 for all that it names, else those of a calibrated rig. The
    difference of the palms' friction is not a matter of calibration and is 0 only if the log says so.
    """
    exact = dict.fromkeys(AS_CALIBRATED, 0.0) | {"friction_sd": AS_CALIBRATED["friction_sd"]}
    return _sds(rig, exact if _exact(rig) else AS_CALIBRATED)


def _exact(rig: Line) -> bool:
    """Whether the log gives standard deviations and all of them are 0."""
    given = [sd for key, sd in _calibration_sd(rig).items() if sd is not None and key != MAP_LENGTH]
    return bool(given) and not any(given)


def _own_sensor(line: Line, common: PadSensor) -> PadSensor:
    """The sensor of one entry of `pads`; standard deviations that it omits are those common to all pads."""
    own = _sensor(line, line, common)
    of_pad = {name: getattr(common, name) for name in CALIBRATION_KEYS if hasattr(common, name)}
    return replace(own, **_sds(line, of_pad))


def _sds(line: Line, default: Mapping[str, float]) -> dict[str, float]:
    """Standard deviations of the constants in `default`; those that `line` omits are as in `default`."""
    given = _calibration_sd(line)
    return {name: not_negative(given, CALIBRATION_KEYS[name], each) for name, each in default.items()}


def _calibration_sd(line: Line) -> Line:
    return {} if line.get("calibration_sd") is None else block(line, "calibration_sd")


# ---------------------------------------------------------------------------------------------------- writing


def line_text(line: Line) -> str:
    """One line of a log as text."""
    return json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n"


def header_line(rig: RigDescription) -> Line:
    """The first line of a log. The fixed end of an arc hinge is not written: logs define it at (L1, 0).

    If the pads differ, `pads` has the values of each, and the common keys have the worse value of both for readers that
    assume identical pads.
    """
    hinge: Line = {"mode": rig.hinge}
    if rig.hinge == "arc":
        hinge["palm1_length_m"] = rig.palm1_length
    pads = [_pad_line(pad) for pad in rig.pads]
    worst = {key: (min if key == "length_m" else max)(pad[key] for pad in pads) for key in pads[0]}
    sds = {key: _calibration_sd_of(rig, name) for name, key in CALIBRATION_KEYS.items()}
    sds[MAP_LENGTH] = max(rig.pads, key=lambda pad: pad.map_sd).map_length
    described: Line = {
        "gravity_m_s2": rig.gravity,
        "hinge": hinge,
        "pad": {key: worst.pop(key) for key in ("length_m", "noise_m", "resolution_m")},
        "force_scale_std": worst.pop("force_scale_std"),
        "force_gain_std": worst.pop("force_gain_std"),
        "palm_angle_noise_rad": rig.palm_angle_noise,
        **({"goal_rounding_rad": rig.goal_rounding} if rig.goal_rounding else {}),
        **worst,
        "calibration_sd": sds,
        "vibration": vibration_line(rig.vibration),
        **{_CURVATURE.format(palm): kappa for palm, kappa in zip(PALMS, rig.curvatures, strict=True) if kappa},
    }
    if any(replace(pad, curvature=rig.pads[0].curvature) != rig.pads[0] for pad in rig.pads):
        of_pad = {name: key for name, key in CALIBRATION_KEYS.items() if hasattr(rig.pads[0], name)}
        described["pads"] = [
            line
            | {
                "calibration_sd": {key: getattr(pad, name) for name, key in of_pad.items()}
                | {MAP_LENGTH: pad.map_length}
            }
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


def _calibration_sd_of(rig: RigDescription, name: str) -> float:
    """Standard deviation of a rig constant; for a constant of each pad, the larger one."""
    return float(getattr(rig, name)) if hasattr(rig, name) else max(getattr(pad, name) for pad in rig.pads)


def event_line(event: Event) -> Line | None:
    """One event as a line; None for a `PadLift`, which shows as a gap in the readings."""
    if isinstance(event, PadSample):
        force = {} if event.force is None else {"force_n": event.force}
        return {"t": event.t_sample, "pad": event.pad, "s_m": event.s, **force}
    if isinstance(event, PalmSample):
        columns = ((_ANGLES, event.angles), (_RATES, event.rates), (_ACCELERATIONS, event.accelerations))
        palms = {name: value for names, values in columns for name, value in zip(names, values or (), strict=False)}
        return {"t": event.t_sample, "palms": palms}
    return None
