"""Texts of a run's report: facts, tables, and captions with numbers from the data. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from palmd.chords import STRAIGHT_LABEL, chords_of
from palmd.observer.shape_classification import root_of_band, shape_class
from palmd.observer.validity import MOST_NIS
from palmd.quantities import ESTIMATE, MOTION
from palmd.record.damage import damage_text
from palmd.record.metadata import CONFIG
from palmd.report.errors import (
    HIDDEN_STATE,
    STATE,
    Errors,
    body_at,
    count_within_band,
    last_outlines,
    normalised_errors,
    outline_errors,
)
from palmd.report.findings import NOTE, RunVerdict
from palmd.report.series import SD, SDS, Interval, OutlineAt, Series
from palmd.system.mechanism import ENDS, JOINTS

_COUNTER_PREFIXES = tuple(f"{end}_" for end in (*ENDS, "bus", "smoother", "explorer"))


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells with a header."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def facts(series: Series) -> tuple[tuple[str, str], ...]:
    """The title block: name and value."""
    metadata = series.run.metadata
    started = metadata.get("started")
    start = datetime.fromisoformat(started).strftime("%Y-%m-%d %H:%M:%S %Z").strip() if started else "unknown"
    versions = ", ".join(
        f"{name} {metadata[name]}" for name in ("palmd", "python", "numpy", "casadi") if name in metadata
    )
    entries = [
        ("started", start),
        ("duration", f"{series.duration:.1f} s"),
        ("versions", f"{versions}; {metadata.get('machine', 'machine unknown')}"),
        ("observer", series.observer),
        ("configuration", metadata.get("config_hash", "hash unknown")),
        ("objects", _objects(series)),
        ("recording", _recording(series)),
        ("missing", _lost(series)),
        ("outcome", outcome(series)),
    ]
    if metadata.get("continues"):
        gap_s = float(metadata.get("gap_s", 0.0))
        gap = f"; {gap_s:.1f} s between them are not recorded" if gap_s else ""
        entries.insert(1, ("continues", metadata["continues"] + gap))
    return tuple(entries)


def outcome(series: Series) -> str:
    """Result of the run: touched fraction, largest standard deviation, and errors if the truth is known."""
    if not series.valid.any():
        return "no estimate was valid"
    first = float(series.estimate.t[int(np.argmax(series.valid))])
    parts = [f"valid {series.valid.sum() / len(series.valid):.0%} of the ticks, first at {first:.1f} s"]
    outlines = last_outlines(series)
    if not outlines or not outlines[-1].valid:
        touched = series.estimate["touched"]
        known = bool(len(series.shape)) and bool(np.isfinite(touched).any())
        last = f"{np.nanmax(touched):.0%} touched" if known else "this observer estimates no outline"
        return "; ".join([*parts, last])
    return "; ".join([*parts, *(_outline_summary(series, outline, several=len(outlines) > 1) for outline in outlines)])


def player_caption(series: Series) -> str:
    """Caption of the playback."""
    truth = " Dashed: the truth, rotated to fit the last outline." if series.bodies else ""
    return (
        "Relative to the hinge: palms grey, contacts orange, the outline as estimated at the time, bold where touched, "
        "coloured by standard deviation: dark blue up to 20 µm, blue up to 50 µm, orange up to 200 µm, brown beyond; "
        f"no outline without a valid estimate.{truth} Below: touched fraction, states, faults (red)."
    )


def outline_caption(series: Series, outline: OutlineAt) -> str:
    """Caption of an outline."""
    name = f"Object {outline.number} at {outline.t:.1f} s" + ("" if outline.valid else ", never valid")
    text = f"{name}: mean radius {_mm(float(outline.h.mean()))}, {outline.touched.mean():.0%} of the normals touched"
    if outline.touched.any():
        text += f", median ±{SDS:g} sd there {_um(SDS * float(np.median(outline.h_sd[outline.touched])))}"
    root = root_of_band(outline.h_sd, outline.theta)
    if outline.valid and (form := shape_class(outline.theta, outline.h, root, outline.touched)).text:
        text += f"; looks like: {form.text}"
    if chords := chords_of(outline.theta, outline.h, outline.touched):
        text += f"; straight parts of the hull, which is what palms touch ({STRAIGHT_LABEL}, dashed): "
        text += ", ".join(_mm(chord.length) for chord in chords)
    body = body_at(series, outline.t)
    if body is None:
        return text + "; the truth is not known."
    errors = outline_errors(outline, body)
    within = float(np.mean(np.abs(errors.error) <= SDS * outline.h_sd))
    return (
        f"{text}; rotated for the best fit weighted by sd, the truth lies within the band on {within:.0%} of the "
        "normals. Panel b is cut off at 45% of the mean radius."
    )


def contacts_caption(series: Series) -> str:
    """Caption of the contacts of an observer without a shape."""
    return (
        f"The {series.observer} observer estimates no outline; each point is a contact as estimated at its own tick, "
        "and scatters with the errors of r, s and ψ of that tick."
    )


def frames_caption(series: Series, numbers: Sequence[int]) -> str:
    """Caption of the frames."""
    t = series.estimate.t[list(numbers)]
    known = "touched arcs bold, the rest faint" if series.outlines else "dots for the contacts so far"
    percent = "; the percentage is the touched fraction of the normals" if series.outlines else ""
    return (
        f"{len(t)} valid estimates from {t[0]:.1f} s to {t[-1]:.1f} s, relative to the hinge: palms grey, contacts "
        f"orange, centre of mass +, {known}{percent}."
    )


def state_caption(series: Series) -> str:
    """Caption of the state, with its standard deviations at the end."""
    valid = np.flatnonzero(series.valid)
    if not len(valid):
        return "No estimate was valid; the grey lines are unconfirmed."
    *radii, omega0 = (
        f"{_with_unit(name, float(series.estimate[SD + name][valid[-1]]))} for {ESTIMATE[name].symbol}"
        for name in HIDDEN_STATE
    )
    return (
        f"Standard deviations at the last valid tick ({series.estimate.t[valid[-1]]:.1f} s): {', '.join(radii)} "
        f"and {omega0}; times without a valid estimate are grey."
    )


def errors_caption(series: Series, errors: Errors) -> str:
    """Caption of the errors: fractions within the bands, and RMS errors."""
    counts = [count_within_band(series, errors, name) for name in HIDDEN_STATE]
    if not all(judged for _, judged in counts):
        return "The truth is not known for any valid estimate."
    shares = ", ".join(
        f"{ESTIMATE[name].symbol} {within / judged:.0%}"
        for name, (within, judged) in zip(HIDDEN_STATE, counts, strict=True)
    )
    rms = ", ".join(
        _with_unit(name, float(np.sqrt(np.nanmean(errors.error[name][series.valid] ** 2)))) for name in HIDDEN_STATE
    )
    worst = min(
        (within / judged, name) for name in STATE if name in errors.error
        for within, judged in [count_within_band(series, errors, name)] if judged
    )  # fmt: skip
    return (
        f"Within ±{SDS:g} sd (expected: 95%): {shares} of {counts[0][1]} valid ticks, smallest for "
        f"{ESTIMATE[worst[1]].symbol} ({worst[0]:.0%}); RMS errors {rms}."
    )


def motion_caption(series: Series) -> str:
    """Caption of the motion: ranges of angles, tracking time, and faults."""
    motion = series.motion
    if not np.isfinite(motion[f"{JOINTS[0]}_rad"]).any():
        return "The arm reported no angles."
    ranges = ", ".join(
        f"{MOTION[name].symbol} {np.degrees(np.nanmin(motion[name])):.0f}–{np.degrees(np.nanmax(motion[name])):.0f}°"
        for name in (f"{joint}_rad" for joint in JOINTS)
    )
    tracking = sum(interval.end - interval.begin for interval in series.states if interval.label == "tracking")
    codes = {fault.code for fault in series.faults}
    return (
        f"The palms covered {ranges}; palmd was tracking for {tracking:.1f} s of {series.duration:.1f} s; "
        f"{_count(len(codes), 'kind') if codes else 'no kind'} of fault occurred."
    )


def forces_caption(series: Series, errors: Errors | None) -> str:
    """Caption of the forces: mass and friction at the last valid tick, of which there must be one."""
    last = np.flatnonzero(series.valid)[-1]

    def text_of(name: str) -> str:
        shown = ESTIMATE[name].shown
        factor, digits, unit = shown.factor, f".{shown.digits}f", f" {shown.unit}".rstrip()
        value, sd = (float(series.estimate[key][last]) * factor for key in (name, SD + name))
        if not math.isfinite(value):
            return "unknown"
        text = f"{value:{digits}} ± {sd:{digits}}{unit}" if math.isfinite(sd) else f"{value:{digits}}{unit}"
        if errors is not None and name in errors.true and math.isfinite(errors.true[name][last]):
            text += f" (truth {float(errors.true[name][last]) * factor:{digits}})"
        return text

    mass, mu = text_of("mass_kg"), text_of("mu")
    return f"At the last valid tick: mass {mass}, μ {mu} (± 1 sd)."


def consistency_caption(series: Series, errors: Errors | None) -> str:
    """Caption of the consistency: NIS of the innovations, and normalised errors."""
    nis = series.estimate["nis"][series.valid]
    nis = nis[np.isfinite(nis)]
    if not len(nis):
        return "The innovations of valid estimates are not known."
    text = (
        f"{np.mean(nis < MOST_NIS):.0%} of the valid ticks have a mean NIS below {MOST_NIS:g}, the observer's limit; "
        f"its mean is {nis.mean():.2f}"
    )
    if errors is not None:
        squares = normalised_errors(series, errors)
        squares = squares[np.isfinite(squares)]
        if len(squares):
            text += (
                f", and that of (error / sd)² of r₁, r₂, ω₀ is {squares.mean():.2f} (median {np.median(squares):.2f}), "
                "computed field by field, as runs hold no covariances"
            )
    return text + "."


def coverage_caption(series: Series) -> str:
    """Caption of the coverage: how much was touched, and when."""
    touched = series.estimate["touched"]
    if not np.isfinite(touched).any() or not series.outlines:
        return "This observer estimates no outline."
    best = float(np.nanmax(touched))
    half = series.estimate.t[int(np.argmax(touched >= best / 2))]
    last = last_outlines(series)[-1]
    return (
        f"At most {best:.0%} of the normals were touched, half of that at {half:.1f} s; the largest sd of the "
        f"last outline is {_um(float(last.h_sd.max()))}; the fixed-lag smoother answered "
        f"{_count(len(series.improvements), 'time')} (short strokes at the bottom)."
    )


def loop_caption(series: Series) -> str:
    """Caption of the loop's timing."""
    if not len(series.loop.t):
        return "The run holds no palm/loop."
    late, work = (float(np.nanmax(series.loop[f"{what}_p99_ms"])) for what in ("lateness", "work"))
    return (
        f"99th percentiles of the worst second: lateness {late:.2f} ms, work {work:.2f} ms; "
        f"{_count(int(series.counts['overruns']), 'tick')} skipped of {int(series.counts['ticks'])}."
    )


def error_counts(series: Series) -> Table:
    """The nonzero counters of ports and helper processes at the run's end."""
    rows = []
    for name, value in series.counts.items():
        owner = next((cause for cause in _COUNTER_PREFIXES if name.startswith(cause)), "")
        if value and (owner or name == "late_dropped"):
            rows.append((owner.rstrip("_") or "observer", name.removeprefix(owner).replace("_", " "), f"{value:g}"))
    return Table(("where", "counter, since the start", "count"), tuple(rows))


def faults(series: Series) -> Table:
    """Every interval of every fault."""
    rows = tuple(
        (
            f"{fault.begin:.2f}",
            "to the end" if fault.active_at_end else f"{fault.end - fault.begin:.2f}",
            fault.severity,
            fault.code,
            fault.hint,
        )
        for fault in series.faults
    )
    return Table(("at (s)", "duration (s)", "severity", "fault", "what to do"), rows)


def verdict(verdict: RunVerdict) -> str:
    """The verdict in a sentence: the word, and the most severe finding."""
    first = verdict.findings[0] if verdict.findings and verdict.findings[0].level != NOTE else None
    return f"{verdict.word}: {first.what}" if first else f"{verdict.word}: nothing failed"


def findings(verdict: RunVerdict) -> Table:
    """The findings in order of severity."""
    rows = tuple(
        (each.level, f"{each.what}. Next: {each.action}" if each.action else each.what) for each in verdict.findings
    )
    return Table(("severity", "finding, and what to do next"), rows)


def ratios(verdict: RunVerdict) -> Table:
    """Measured values and their limits; a test fails if the ratio is above 1."""
    rows = []
    for each in verdict.ratios:
        value, limit = (f"{number:.3g} {each.unit}".rstrip() for number in (each.value, each.limit))
        rows.append((each.name, value, limit, f"{each.ratio:.2f}", "failed" if each.ratio > 1.0 else "passed"))
    return Table(("test", "value", "limit", "ratio", "result"), tuple(rows))


def log(series: Series) -> Table:
    """The daemon's log; only for runs that have one."""
    rows = tuple((f"{entry.t_s:.2f}", entry.kind, entry.severity, entry.line) for entry in series.log)
    return Table(("at (s)", "about", "severity", "what"), rows)


def rig(series: Series) -> Table:
    """Significant deviations of the rig from its description, estimated by the end of the run; only if published."""
    return Table(("significant deviation at the end",), tuple((text,) for text in series.rig_deviations or ()))


def topics(series: Series) -> Table:
    """Number and rate of messages of each topic."""
    rows = []
    for name, survey in sorted(series.survey.items()):
        seconds = (survey.end_ns - survey.begin_ns) * 1e-9
        rate = f"{(survey.count - 1) / seconds:.1f}" if seconds > 0 else "–"
        rows.append((name, str(survey.count), rate, str(survey.missing)))
    return Table(("topic", "messages", "rate (1/s)", "missing"), tuple(rows))


def configuration(series: Series) -> str:
    """The recorded configuration (YAML)."""
    return series.run.preface.attachments[CONFIG].decode()


def durations(intervals: Iterable[Interval]) -> Table:
    """Total duration of each state."""
    total: dict[str, float] = {}
    for interval in intervals:
        total[interval.label] = total.get(interval.label, 0.0) + interval.end - interval.begin
    return Table(("state", "duration (s)"), tuple((label, f"{seconds:.1f}") for label, seconds in total.items()))


def _objects(series: Series) -> str:
    objects = series.objects
    if not objects:
        return "none"
    with_estimate = np.unique(series.estimate["object"][series.valid]).astype(int).tolist()
    if len(objects) == 1:
        return "one" if with_estimate else "one, never valid"
    names = ", ".join(map(str, with_estimate)) or "none"
    return f"{len(objects)}; with a valid estimate: {names}"


def _recording(series: Series) -> str:
    damage = series.run.damage
    if damage.damaged:
        return damage_text(damage, series.run.layout.begin_ns)
    if series.run.complete:
        return "complete"
    return f"not finished: {damage.torn_bytes} bytes of an incomplete message at the end are ignored"


def _lost(series: Series) -> str:
    missing = {name: survey.missing for name, survey in series.survey.items() if survey.missing}
    if not missing:
        return "no message is missing between the first and the last"
    return ", ".join(f"{count} of {name}" for name, count in sorted(missing.items()))


def _outline_summary(series: Series, outline: OutlineAt, *, several: bool) -> str:
    name = f"object {outline.number}: " if several else ""
    text = f"{name}{outline.touched.mean():.0%} of the normals touched, worst sd {_um(float(outline.h_sd.max()))}"
    body = body_at(series, outline.t)
    if body is None:
        return text
    errors = outline_errors(outline, body)
    return (
        f"{text}, errors over all normals: e_h {_um(errors.whole_score.e_h)}, Hausdorff "
        f"{_um(errors.whole_score.max_error)}"
        + (f", e_h where touched {_um(errors.touched_score.e_h)}" if outline.touched.any() else "")
    )


def _with_unit(name: str, value: float) -> str:
    """A standard deviation or error (SI) of an estimated quantity as text with unit."""
    shown = ESTIMATE[name].shown
    return _um(value) if ESTIMATE[name].unit == "m" else f"{value * shown.factor:.3g} {shown.unit}"


def _mm(metres: float) -> str:
    return f"{metres * 1e3:.2f} mm"


def _um(metres: float) -> str:
    return f"{metres * 1e6:.3g} µm" if metres < 1e-3 else _mm(metres)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
