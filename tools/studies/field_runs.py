"""The runs of the field's benchmark: the emulated rig as calibration leaves one, recorded by the daemon's own ears.

A run lives in the rig without wires (`harness.wireless`): the pads' bytes, the arm's cycle and its delays are the real
ones, the rig is off from its configuration by what calibration leaves, and the palms rock by a plan drawn from the
seed. What the observer is fed becomes an event log, what was really there its truth.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from palmd.config.two_palms import PlanSpec, rig_description
from palmd.events import Event
from palmd.harness.wireless import Instant, Wireless
from palmd.motion.plan import PlanError
from palmd.record.eventlog import event_line, header_line
from palmd.record.logline import Line
from palmd.rig.imperfections import configured
from palmd.rig.shapes import KINDS, Kind
from palmd.rig.world import default_config
from palmd.score import support_at
from tools.studies.silent_observer import SilentObserver

TRUTH_COLUMNS = ("psi_rad", "omega0_rad_s", "r1_m", "r2_m", "s1_m", "s2_m", "phi1_rad", "phi2_rad")
_STREAM = 24  # of a seed's random numbers: the plan's, not the world's
_ATTEMPT = 100_000  # added to the world's seed when a contact was lost
_SETTLE_S = 0.6


class _Ears(SilentObserver):
    """It keeps what it is fed."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def feed(self, event: Event) -> None:
        self.events.append(event)


def name_of(seed: int) -> str:
    """What the files of a run begin with."""
    return f"{seed:04d}"


def kind_of(seed: int) -> Kind:
    """The kinds of objects take turns."""
    return KINDS[seed % len(KINDS)]


def written(folder: Path, seed: int, seconds: float) -> Path:
    """The log of a run, its truth beside it; made when it is not there yet. Raises OSError, WirelessError."""
    log = folder / f"{name_of(seed)}.jsonl"
    truth = log.with_suffix(".truth.json")
    if not (log.exists() and truth.exists()):
        lines, told = made(seed, seconds)
        log.write_text("".join(json.dumps(line, separators=(",", ":")) + "\n" for line in lines), encoding="utf-8")
        truth.write_text(json.dumps(told, separators=(",", ":")) + "\n", encoding="utf-8")
    return log


def made(seed: int, seconds: float) -> tuple[list[Line], dict[str, Any]]:
    """The log's lines, header first, and the truth; same seed, same run.

    A plan beyond the rig's limits, or one that loses a contact, is drawn again.
    """
    attempt = 0
    while True:
        drawn = _lived(seed, attempt, seconds)
        if drawn is not None:
            return drawn
        attempt += 1


def plan_of(seed: int, attempt: int = 0) -> PlanSpec:
    """The palms' motion: to a middle, then a sine of each about it."""
    rng = np.random.default_rng([seed, attempt, _STREAM])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    middle = {"phi1_deg": between(40, 46), "phi2_deg": between(88, 94)}
    sine = {"phi1_deg": between(18, 28), "phi2_deg": between(6, 12) * float(rng.choice((-1.0, 1.0)))}
    frequency = [between(0.4, 0.7), between(0.4, 0.8)]
    segments = [
        {"move": middle, "duration_s": _SETTLE_S},
        {"sine": sine, "frequency_hz": frequency, "duration_s": 20.0},
    ]
    return PlanSpec.model_validate({"name": "field", "repeat": "forever", "segments": segments})


def _lived(seed: int, attempt: int, seconds: float) -> tuple[list[Line], dict[str, Any]] | None:
    config = default_config("calibrated")
    rig = rig_description(config)
    ears = _Ears()
    spec = plan_of(seed, attempt)
    try:
        wireless = Wireless(config, spec, seed + _ATTEMPT * attempt, kind=kind_of(seed), estimator=ears)
    except PlanError:
        return None
    wireless.start()
    begun = wireless.t
    instants = []
    for instant in wireless.run(seconds):
        if not (instant.truth["contact1"] and instant.truth["contact2"]):
            return None
        instants.append(instant)
    header = header_line(rig) | {"run": name_of(seed), "kind": kind_of(seed), "seed": seed, "attempt": attempt}
    events = sorted((event for event in ears.events if event.t_sample >= begun), key=lambda event: event.t_sample)
    off = configured(config, wireless.world.seed).constants()
    return [header, *_lines(events)], _truth(wireless, instants) | {"rig": off}


def _lines(events: list[Event]) -> Iterator[Line]:
    for event in events:
        line = event_line(event)
        if line is not None:
            yield {key: _short(value) for key, value in line.items()}


def _short(value: Any) -> Any:
    """Numbers to a nanosecond, a nanometre, a nanoradian: what lies beyond is noise."""
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    return round(value, 9) if isinstance(value, float) else value


def _truth(wireless: Wireless, instants: list[Instant]) -> dict[str, Any]:
    """The body, and the motion at each tick, in the fields of the reference truth files; ψ = 0 at the beginning."""
    body = wireless.world.object_truth()
    begun = float(instants[0].truth["psi_rad"])
    h = support_at(np.array(body["h_m"]), np.array(body["theta_rad"]) - begun)
    columns = {name: [_short(each.truth[name]) for each in instants] for name in TRUTH_COLUMNS}
    columns["t"] = [_short(each.t) for each in instants]
    if not all(math.isfinite(value) for column in columns.values() for value in column):
        raise ValueError("the emulated rig told no number")
    columns["psi_rad"] = [_short(psi - begun) for psi in columns["psi_rad"]]
    return body | columns | {"h_m": [_short(value) for value in h.tolist()]}
