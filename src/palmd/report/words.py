"""What a run's report says in words: facts, tables, and under each figure one sentence from the data. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from palmd.chords import MEANT, chords_of
from palmd.observer.shape_classification import root_of_band, shape_class
from palmd.observer.validity import MOST_NIS
from palmd.quantities import ESTIMATE, MOTION
from palmd.record.damage import damage_text
from palmd.record.metadata import CONFIG
from palmd.report.errors import OBJECTS_OWN, SDS, STATE, Errors, against, body_at, inside, last_outlines, normalised
from palmd.report.findings import NOTE, RunVerdict
from palmd.report.series import SD, OutlineAt, Series, Spell
from palmd.system.mechanism import ENDS, JOINTS

_CAUSES = tuple(f"{end}_" for end in (*ENDS, "bus", "smoother", "explorer"))


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of cells under a head; empty ones are told as such."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def facts(series: Series) -> tuple[tuple[str, str], ...]:
    """The title block: name and value."""
    metadata = series.run.metadata
    started = metadata.get("started")
    begun = datetime.fromisoformat(started).strftime("%Y-%m-%d %H:%M:%S %Z").strip() if started else "unknown"
    versions = ", ".join(
        f"{name} {metadata[name]}" for name in ("palmd", "python", "numpy", "casadi") if name in metadata
    )
    said = [
        ("begun", begun),
        ("duration", f"{series.duration:.1f} s"),
        ("versions", f"{versions}; {metadata.get('machine', 'machine unknown')}"),
        ("observer", series.observer),
        ("configuration", metadata.get("config_hash", "hash unknown")),
        ("objects", _objects(series)),
        ("recording", _recording(series)),
        ("lost", _lost(series)),
        ("outcome", outcome(series)),
    ]
    if metadata.get("continues"):
        gap_s = float(metadata.get("gap_s", 0.0))
        gap = f"; {gap_s:.1f} s between them are not recorded" if gap_s else ""
        said.insert(1, ("goes on from", metadata["continues"] + gap))
    return tuple(said)


def outcome(series: Series) -> str:
    """How far it came: touched share, worst sd, and errors where there is truth."""
    if not series.valid.any():
        return "no estimate was ever called valid"
    told = [
        f"valid {_share(series.valid.sum(), len(series.valid))} of the ticks, first at {_first_valid(series):.1f} s"
    ]
    outlines = last_outlines(series)
    if not outlines or not outlines[-1].valid:
        touched = series.estimate["touched"]
        known = bool(len(series.shape)) and bool(np.isfinite(touched).any())
        last = f"{np.nanmax(touched):.0%} touched" if known else "this observer tells no outline"
        return "; ".join([*told, last])
    return "; ".join([*told, *(_outline_told(series, outline, several=len(outlines) > 1) for outline in outlines)])


def under_player(series: Series) -> str:
    """About the run that can be played back."""
    truth = " Dashed: the truth, turned to fit the last outline." if series.bodies else ""
    return (
        "Seen from the hinge: palms grey, contacts orange, the outline as it was known then, bold where touched, "
        "coloured by its one-sigma: dark blue up to 20 µm, blue up to 50 µm, orange up to 200 µm, brown beyond; "
        f"none without a valid estimate.{truth} Below: touched share, states, faults (red)."
    )


def under_outline(series: Series, outline: OutlineAt) -> str:
    """About the outline at its time."""
    name = f"Object {outline.number} at {outline.t:.1f} s" + ("" if outline.valid else ", never called valid")
    said = f"{name}: mean radius {_mm(float(outline.h.mean()))}, {outline.touched.mean():.0%} of the normals touched"
    if outline.touched.any():
        said += f", median ±{SDS:g} sd there {_um(SDS * float(np.median(outline.h_sd[outline.touched])))}"
    root = root_of_band(outline.h_sd, outline.theta)
    if outline.valid and (form := shape_class(outline.theta, outline.h, root, outline.touched)).said:
        said += f"; looks like: {form.said}"
    if chords := chords_of(outline.theta, outline.h, outline.touched):
        said += f"; of the hull, which is what palms feel, straight ({MEANT}, dashed): "
        said += ", ".join(_mm(chord.length) for chord in chords)
    body = body_at(series, outline.t)
    if body is None:
        return said + "; the truth is not known."
    found = against(outline, body)
    within = float(np.mean(np.abs(found.error) <= SDS * outline.h_sd))
    return (
        f"{said}; turned to where it fits best by its own sd, the truth lies within the band on {within:.0%} of the "
        "normals. Panel b cuts what is farther off than 45% of the mean radius."
    )


def under_felt(series: Series) -> str:
    """About the contacts of an observer without a shape."""
    return (
        f"The {series.observer} observer tells no outline; each point is a contact as it was placed at its own tick, "
        "so that they scatter by the errors of r, s and ψ of that tick."
    )


def under_frames(series: Series, numbers: Sequence[int]) -> str:
    """About the frames."""
    t = series.estimate.t[list(numbers)]
    known = "touched arcs bold, the rest faint" if series.outlines else "dots where it was touched up to then"
    percent = "; the percentage is the touched share of the normals" if series.outlines else ""
    return (
        f"{len(t)} valid estimates from {t[0]:.1f} s to {t[-1]:.1f} s, seen from the hinge: palms grey, contacts "
        f"orange, centre of mass +, {known}{percent}."
    )


def under_state(series: Series) -> str:
    """About the state's sd at the end."""
    valid = np.flatnonzero(series.valid)
    if not len(valid):
        return "No estimate was called valid: the lines are grey, and nobody vouches for them."
    *radii, omega0 = (
        f"{_small(name, float(series.estimate[SD + name][valid[-1]]))} for {ESTIMATE[name].symbol}"
        for name in OBJECTS_OWN
    )
    return (
        f"At the last valid tick ({series.estimate.t[valid[-1]]:.1f} s) one sd is {', '.join(radii)} "
        f"and {omega0}; grey times have no valid estimate."
    )


def under_errors(series: Series, errors: Errors) -> str:
    """How often the errors keep to their bands."""
    told = [inside(series, errors, name) for name in OBJECTS_OWN]
    if not all(judged for _, judged in told):
        return "No valid estimate has a truth beside it."
    shares = ", ".join(
        f"{ESTIMATE[name].symbol} {within / judged:.0%}"
        for name, (within, judged) in zip(OBJECTS_OWN, told, strict=True)
    )
    rms = ", ".join(
        _small(name, float(np.sqrt(np.nanmean(errors.error[name][series.valid] ** 2)))) for name in OBJECTS_OWN
    )
    worst = min(
        (within / judged, name) for name in STATE if name in errors.error
        for within, judged in [inside(series, errors, name)] if judged
    )  # fmt: skip
    return (
        f"Within ±{SDS:g} sd, where 95% would be expected: {shares} of {told[0][1]} valid ticks, least often "
        f"{ESTIMATE[worst[1]].symbol} ({worst[0]:.0%}); RMS errors {rms}."
    )


def under_motion(series: Series) -> str:
    """What the palms did, and what went wrong meanwhile."""
    motion = series.motion
    if not np.isfinite(motion[f"{JOINTS[0]}_rad"]).any():
        return "The arm told no angles."
    ranges = ", ".join(
        f"{MOTION[name].symbol} {np.degrees(np.nanmin(motion[name])):.0f}–{np.degrees(np.nanmax(motion[name])):.0f}°"
        for name in (f"{joint}_rad" for joint in JOINTS)
    )
    tracking = sum(spell.end - spell.begin for spell in series.states if spell.what == "tracking")
    codes = {fault.code for fault in series.faults}
    return (
        f"The palms covered {ranges}; palmd was tracking for {tracking:.1f} s of {series.duration:.1f} s; "
        f"{_count(len(codes), 'kind') if codes else 'no kind'} of fault stood at some time."
    )


def under_forces(series: Series, errors: Errors | None) -> str:
    """Mass and friction at the last valid tick, of which there must be one."""
    last = np.flatnonzero(series.valid)[-1]

    def told(name: str) -> str:
        shown = ESTIMATE[name].shown
        factor, digits, unit = shown.factor, f".{shown.digits}f", f" {shown.unit}".rstrip()
        value, sd = (float(series.estimate[key][last]) * factor for key in (name, SD + name))
        if not math.isfinite(value):
            return "not told"
        said = f"{value:{digits}} ± {sd:{digits}}{unit}" if math.isfinite(sd) else f"{value:{digits}}{unit}"
        if errors is not None and name in errors.true and math.isfinite(errors.true[name][last]):
            said += f" (truth {float(errors.true[name][last]) * factor:{digits}})"
        return said

    mass, mu = told("mass_kg"), told("mu")
    return f"At the last valid tick: mass {mass}, μ {mu}, one sd each."


def under_consistency(series: Series, errors: Errors | None) -> str:
    """How often the innovations are as large as they should be, and the errors."""
    nis = series.estimate["nis"][series.valid]
    nis = nis[np.isfinite(nis)]
    if not len(nis):
        return "The innovations of valid estimates are not told."
    said = (
        f"Of the valid ticks {np.mean(nis < MOST_NIS):.0%} have a mean NIS below {MOST_NIS:g}, which the observer asks "
        f"for; its mean is {nis.mean():.2f}"
    )
    if errors is not None:
        squares = normalised(series, errors)
        squares = squares[np.isfinite(squares)]
        if len(squares):
            said += (
                f", and that of (error / sd)² of r₁, r₂, ω₀ is {squares.mean():.2f} (median {np.median(squares):.2f}): "
                "each field by itself, as runs tell of no covariances"
            )
    return said + "."


def under_coverage(series: Series) -> str:
    """How much was touched, and when."""
    touched = series.estimate["touched"]
    if not np.isfinite(touched).any() or not series.outlines:
        return "This observer tells no outline."
    best = float(np.nanmax(touched))
    half = series.estimate.t[int(np.argmax(touched >= best / 2))]
    last = last_outlines(series)[-1]
    return (
        f"At most {best:.0%} of the normals counted as touched, half of that at {half:.1f} s; the largest sd of the "
        f"last outline is {_um(float(last.h_sd.max()))}; the smoother beside the loop answered "
        f"{_count(len(series.improvements), 'time')} (short strokes at the bottom)."
    )


def under_loop(series: Series) -> str:
    """How punctual the loop was."""
    if not len(series.loop.t):
        return "The run holds no palm/loop."
    late, work = (float(np.nanmax(series.loop[f"{what}_p99_ms"])) for what in ("lateness", "work"))
    return (
        f"The worst second's 99th percentile was {late:.2f} ms late and worked {work:.2f} ms; "
        f"{_count(int(series.counts['overruns']), 'tick')} skipped of {int(series.counts['ticks'])}."
    )


def discarded(series: Series) -> Table:
    """What was counted on each port and beside the loop that is not zero, at the run's end."""
    rows = []
    for name, value in series.counts.items():
        owner = next((cause for cause in _CAUSES if name.startswith(cause)), "")
        if value and (owner or name == "late_dropped"):
            rows.append((owner.rstrip("_") or "observer", name.removeprefix(owner).replace("_", " "), f"{value:g}"))
    return Table(("where", "what, since the start", "count"), tuple(rows))


def faults(series: Series) -> Table:
    """Every spell of every fault."""
    rows = tuple(
        (
            f"{fault.begin:.2f}",
            "stands" if fault.stands else f"{fault.end - fault.begin:.2f}",
            fault.severity,
            fault.code,
            fault.hint,
        )
        for fault in series.faults
    )
    return Table(("at (s)", "for (s)", "severity", "fault", "what to do"), rows)


def verdict(verdict: RunVerdict) -> str:
    """The verdict in a sentence: the word, and the gravest finding."""
    first = verdict.findings[0] if verdict.findings and verdict.findings[0].level != NOTE else None
    return f"{verdict.word}: {first.what}" if first else f"{verdict.word}: nothing failed"


def findings(verdict: RunVerdict) -> Table:
    """In order of weight."""
    rows = tuple(
        (each.level, f"{each.what}. Next: {each.action}" if each.action else each.what) for each in verdict.findings
    )
    return Table(("weight", "what was found, and what to do next"), rows)


def ratios(verdict: RunVerdict) -> Table:
    """Measured values against their limits; above 1 a test fails."""
    rows = []
    for each in verdict.ratios:
        value, limit = (f"{number:.3g} {each.unit}".rstrip() for number in (each.value, each.limit))
        rows.append((each.name, value, limit, f"{each.ratio:.2f}", "failed" if each.ratio > 1.0 else "passed"))
    return Table(("test", "value", "limit", "ratio", "result"), tuple(rows))


def log(series: Series) -> Table:
    """What has happened, as the daemon logged it; only of a run that has a log."""
    rows = tuple((f"{entry.t_s:.2f}", entry.kind, entry.severity, entry.line) for entry in series.log)
    return Table(("at (s)", "about", "severity", "what"), rows)


def rig(series: Series) -> Table:
    """What of the rig the readings have told to be off, by the end of the run; only of a run that tells."""
    return Table(("what is off beyond doubt, in the end",), tuple((said,) for said in series.rig_off or ()))


def topics(series: Series) -> Table:
    """How many messages of each topic there are."""
    rows = []
    for name, survey in sorted(series.survey.items()):
        seconds = (survey.end_ns - survey.begin_ns) * 1e-9
        rate = f"{(survey.count - 1) / seconds:.1f}" if seconds > 0 else "–"
        rows.append((name, str(survey.count), rate, str(survey.missing)))
    return Table(("topic", "messages", "rate (1/s)", "missing"), tuple(rows))


def configuration(series: Series) -> str:
    """The configuration as it was recorded (YAML)."""
    return series.run.preface.attachments[CONFIG].decode()


def spent(spells: Iterable[Spell]) -> Table:
    """How long everything lasted."""
    total: dict[str, float] = {}
    for spell in spells:
        total[spell.what] = total.get(spell.what, 0.0) + spell.end - spell.begin
    return Table(("state", "for (s)"), tuple((what, f"{seconds:.1f}") for what, seconds in total.items()))


def _objects(series: Series) -> str:
    begun = series.objects
    if not begun:
        return "none was begun"
    settled = np.unique(series.estimate["object"][series.valid]).astype(int).tolist()
    if len(begun) == 1:
        return "one" if settled else "one, never settled"
    names = ", ".join(map(str, settled)) or "none"
    return f"{len(begun)} begun; with a valid estimate: {names}"


def _recording(series: Series) -> str:
    damage = series.run.damage
    if damage.damaged:
        return damage_text(damage, series.run.layout.begin_ns)
    if series.run.complete:
        return "complete"
    return f"not finished: {damage.torn_bytes} bytes at its end hold no whole message and are left out"


def _lost(series: Series) -> str:
    missing = {name: survey.missing for name, survey in series.survey.items() if survey.missing}
    if not missing:
        return "no message is missing between the first and the last"
    return ", ".join(f"{count} of {name}" for name, count in sorted(missing.items()))


def _outline_told(series: Series, outline: OutlineAt, *, several: bool) -> str:
    name = f"object {outline.number}: " if several else ""
    said = f"{name}{outline.touched.mean():.0%} of the normals touched, worst sd {_um(float(outline.h_sd.max()))}"
    body = body_at(series, outline.t)
    if body is None:
        return said
    found = against(outline, body)
    return (
        f"{said}, against the truth over all normals e_h {_um(found.all.e_h)}, Hausdorff {_um(found.all.max_error)}"
        + (f", e_h where touched {_um(found.felt.e_h)}" if outline.touched.any() else "")
    )


def _first_valid(series: Series) -> float:
    return float(series.estimate.t[int(np.argmax(series.valid))])


def _share(part: float, whole: int) -> str:
    return f"{part / whole:.0%}"


def _small(name: str, value: float) -> str:
    """A sd or an error of an estimated quantity, SI, in words."""
    shown = ESTIMATE[name].shown
    return _um(value) if ESTIMATE[name].unit == "m" else f"{value * shown.factor:.3g} {shown.unit}"


def _mm(metres: float) -> str:
    return f"{metres * 1e3:.2f} mm"


def _um(metres: float) -> str:
    return f"{metres * 1e6:.3g} µm" if metres < 1e-3 else _mm(metres)


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
