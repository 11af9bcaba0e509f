"""What a run comes to: a verdict, findings in order of weight, each with the next action, and test ratios. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palmd.daemon.journal import LOST_S
from palmd.events import FloatArray
from palmd.observer.validity import MOST_NIS
from palmd.report.errors import SDS, Errors, inside
from palmd.report.series import FOLLOWING_RATIO, FaultSpell, Series

BAD, POOR, NOTE = "failed", "impaired", "note"
LEVELS = (BAD, POOR, NOTE)
"""In order of weight: the run does not give what it is for; it does with reservations; it should be known."""

USUAL_VALID = 0.9
"""Of the ticks after the first valid one."""

INSIDE_LEAST = 0.9
"""Of the errors, that 2 standard deviations should hold; 0.95 for normal errors, which are not independent here."""

PHRASE_HYPHENS = 4
"""A code with as many is a sentence."""

_LEVEL_OF = {"stop": BAD, "hold": POOR, "degrade": POOR}


@dataclass(frozen=True, slots=True)
class RunFinding:
    """What was found, how grave it is (one of `LEVELS`), and the next action; empty where there is nothing to do."""

    level: str
    what: str
    action: str = ""


@dataclass(frozen=True, slots=True)
class TestRatio:
    """A measured value over its limit: above 1 the test fails."""

    name: str
    value: float
    limit: float
    unit: str = ""

    @property
    def ratio(self) -> float:
        """NaN where either is unknown."""
        return self.value / self.limit if self.limit > 0.0 else math.nan


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """`word` is good, impaired or failed; `findings` in order of weight; `ratios` the largest first."""

    word: str
    findings: tuple[RunFinding, ...]
    ratios: tuple[TestRatio, ...]


def verdict_of(series: Series, errors: Errors | None = None) -> RunVerdict:
    """The verdict of a run; `errors` are those against an emulated rig's truth, where it is known."""
    ratios = tuple(sorted(_ratios(series), key=lambda each: -each.ratio))
    found = [
        *_of_estimate(series),
        *_of_faults(series),
        *_of_ratios(ratios),
        *_of_errors(series, errors),
        *_of_file(series),
    ]
    found.sort(key=lambda each: LEVELS.index(each.level))  # stable: as they are named above within a level
    worst = found[0].level if found else NOTE
    return RunVerdict("good" if worst == NOTE else worst, tuple(found), ratios)


# -------------------------------------------------------------------------------------------------------- the estimate


def _of_estimate(series: Series) -> Iterator[RunFinding]:
    valid = series.valid
    run = series.run.path.name
    reasons = " and ".join(map(_in_words, list(series.invalid_reasons)[:2])) or "no reason was published"
    if not valid.any():
        yield RunFinding(
            BAD, f"no estimate was valid in {series.duration:.0f} s; most often: {reasons}",
            f"palmd reconstruct {run} searches the whole run; move the palms more, or longer",
        )  # fmt: skip
        return
    since = int(np.argmax(valid))
    share = float(np.mean(valid[since:]))
    losses = int(np.sum(valid[:-1] & ~valid[1:]))
    lasted = float(series.estimate.t[-1] - series.estimate.t[np.flatnonzero(valid)[-1]])
    if lasted > LOST_S:
        yield RunFinding(
            BAD, f"the object is lost at the end: no valid estimate for the last {lasted:.1f} s ({reasons})",
            f"palmd reconstruct {run}; palmd why {run} where the motion was held",
        )  # fmt: skip
    if share < USUAL_VALID:
        yield RunFinding(
            POOR, f"after the first valid estimate {share:.0%} of the estimates are valid (usual: {USUAL_VALID:.0%} or "
            f"more), lost {losses} times; reasons: {reasons}",
            "see Consistency below; a flat side, a corner or two objects look like this, and so does a moved pad",
        )  # fmt: skip


def _in_words(code: str) -> str:
    """A code as it stands; one that was made of a sentence as words."""
    return code if code.count("-") < PHRASE_HYPHENS else code.replace("-", " ")


# ---------------------------------------------------------------------------------------------------------- the rest


def _of_faults(series: Series) -> Iterator[RunFinding]:
    """One for each code that acted, the most frequent first."""
    by_code: dict[str, list[FaultSpell]] = {}
    for fault in series.faults:
        if fault.severity in _LEVEL_OF:
            by_code.setdefault(fault.code, []).append(fault)
    for code, spells in sorted(by_code.items(), key=lambda item: -len(item[1])):
        seconds = sum(each.end - each.begin for each in spells)
        times = f"{len(spells)} times" if len(spells) > 1 else "once"
        what = f"{code} ({spells[0].severity}) {times}, {seconds:.1f} s in all, first at {spells[0].begin:.1f} s"
        yield RunFinding(_LEVEL_OF[spells[0].severity], what, spells[0].hint)


def _of_ratios(ratios: tuple[TestRatio, ...]) -> Iterator[RunFinding]:
    for each in ratios:
        if each.ratio > 1.0:
            value = f"{each.value:.3g} {each.unit}".rstrip()
            yield RunFinding(
                POOR, f"{each.name}: {value}, {each.ratio:.1f} times its limit of {each.limit:.3g}", _ACTIONS[each.name]
            )  # fmt: skip


def _of_errors(series: Series, errors: Errors | None) -> Iterator[RunFinding]:
    if errors is None or not series.valid.any():
        return
    for name in errors.error:
        within, judged = inside(series, errors, name)
        share = within / judged if judged else math.nan
        if math.isfinite(share) and share < INSIDE_LEAST:
            yield RunFinding(
                POOR, f"{share:.0%} of the errors of {name} against the truth are within {SDS:g} standard deviations "
                "(95 % of normal errors would be)",
                "the bands are too narrow here: report it with palmd bundle",
            )  # fmt: skip


def _of_file(series: Series) -> Iterator[RunFinding]:
    run = series.run
    missing = {name: survey.missing for name, survey in series.survey.items() if survey.missing}
    if run.damage.damaged or not run.complete:
        yield RunFinding(NOTE, "the recording is incomplete", f"palmd runs recover {run.path.name}")
    if missing:
        worst = max(missing, key=lambda name: missing[name])
        yield RunFinding(
            NOTE,
            f"{sum(missing.values())} messages are missing, most of {worst}",
            "take load off the recording machine",
        )
    for said in series.rig_off or ():
        what, _, action = said.partition(": ")
        yield RunFinding(NOTE, what, action)


# ------------------------------------------------------------------------------------------------------- test ratios

_NIS, _FORCE, _FOLLOWING = "normalised innovation squared, median", "normal force, largest", "following error, largest"
_LATE, _WORK, _SKIPPED = (
    "lateness, 99th percentile of the worst second",
    "work of a tick, 99th percentile",
    "skipped ticks",
)
_ACTIONS = {
    _NIS: "readings and model disagree: palmd calibrate self, and look for a second object or a moved pad",
    _FORCE: "see what lies on the pads; lower the plan's accelerations",
    _FOLLOWING: "lower the plan's rates and accelerations; see the arm",
    _LATE: "palmd doctor latency, and take load off this machine",
    _WORK: "palmd doctor build compiles the observers",
    _SKIPPED: "palmd doctor latency, and take load off this machine",
}
SKIPPED_MOST = 0.001
LATE_SHARE, WORK_SHARE = 0.2, 0.5
"""Of a period: what a tick may be late by, and take."""


def _ratios(series: Series) -> Iterator[TestRatio]:
    nis = _finite(series.estimate["nis"][series.valid])
    if len(nis):
        yield TestRatio(_NIS, float(np.median(nis)), MOST_NIS)
    limit = _force_limit(series)
    forces = [_finite(series.estimate[f"f{palm}_n"][series.valid]) for palm in (1, 2, 3)]
    if math.isfinite(limit) and any(map(len, forces)):
        yield TestRatio(_FORCE, max(float(each.max()) for each in forces if len(each)), limit, "N")
    following = _finite(series.motion[FOLLOWING_RATIO])
    if len(following):
        yield TestRatio(_FOLLOWING, float(following.max()), 1.0)
    if len(series.loop.t):
        period_ms = 1e3 / series.run.config.loop.rate_hz
        for name, column, share in ((_LATE, "lateness_p99_ms", LATE_SHARE), (_WORK, "work_p99_ms", WORK_SHARE)):
            values = _finite(series.loop[column])
            if len(values):
                yield TestRatio(name, float(values.max()), share * period_ms, "ms")
        if series.counts.get("ticks"):
            yield TestRatio(_SKIPPED, series.counts["overruns"] / series.counts["ticks"], SKIPPED_MOST)


def _force_limit(series: Series) -> float:
    """What the run's `palm/info` says; NaN where it does not."""
    for message in series.run.messages(series.run.topics.info.name):
        found = message.fields.get("force_limit_n", math.nan)
        limits = found if isinstance(found, list) else [found]
        return min((float(each) for each in limits), default=math.nan)
    return math.nan


def _finite(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)])
