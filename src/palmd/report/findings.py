"""Verdict on a run: findings in order of severity, each with the next action, and test ratios. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from palmd.daemon.journal import LOST_S
from palmd.events import FloatArray
from palmd.observer.validity import MOST_NIS
from palmd.report.errors import Errors, count_within_band
from palmd.report.series import FOLLOWING_RATIO, SDS, FaultInterval, Series
from palmd.systems import TWO_PALMS

FAILED, IMPAIRED, NOTE = "failed", "impaired", "note"
LEVELS = (FAILED, IMPAIRED, NOTE)
"""In order of severity: the run is not usable for its purpose; usable with reservations; for information."""

MIN_VALID_FRACTION = 0.9
"""Smallest fraction of valid ticks after the first valid one."""

MIN_WITHIN_FRACTION = 0.9
"""Smallest fraction of errors within 2 standard deviations; 0.95 for normal errors, but they are correlated here."""

PHRASE_HYPHENS = 4
"""A code with this many hyphens or more is a sentence and is shown as words."""

_LEVEL_OF = {"stop": FAILED, "hold": IMPAIRED, "degrade": IMPAIRED}


@dataclass(frozen=True, slots=True)
class RunFinding:
    """One finding, its severity (one of `LEVELS`), and the next action, empty if there is nothing to do."""

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
        """Value divided by limit; NaN if either is unknown."""
        return self.value / self.limit if self.limit > 0.0 else math.nan


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """`word` is good, impaired or failed; `findings` in order of severity; `ratios` in descending order."""

    word: str
    findings: tuple[RunFinding, ...]
    ratios: tuple[TestRatio, ...]


def verdict_of(series: Series, errors: Errors | None = None) -> RunVerdict:
    """The verdict on a run; `errors` are those against an emulated rig's truth, if known."""
    ratios = tuple(sorted(_ratios(series), key=lambda each: -each.ratio))
    found = [
        *_of_estimate(series),
        *_of_faults(series),
        *_of_ratios(ratios),
        *_of_errors(series, errors),
        *_of_file(series),
    ]
    found.sort(key=lambda each: LEVELS.index(each.level))  # stable sort: the order above is kept within a level
    worst = found[0].level if found else NOTE
    return RunVerdict("good" if worst == NOTE else worst, tuple(found), ratios)


# -------------------------------------------------------------------------------------------------------- the estimate


def _of_estimate(series: Series) -> Iterator[RunFinding]:
    valid = series.valid
    run = series.run.path.name
    again = f"palmd reconstruct {run}" if series.run.system == TWO_PALMS else ""  # supported for two palms only
    reasons = " and ".join(map(_in_words, list(series.invalid_reasons)[:2])) or "no reason was published"
    if not valid.any():
        yield RunFinding(
            FAILED, f"no estimate was valid in {series.duration:.0f} s; most frequent reasons: {reasons}",
            f"{again} searches the whole run; move more, or longer" if again else "explore for longer",
        )  # fmt: skip
        return
    since = int(np.argmax(valid))
    share = float(np.mean(valid[since:]))
    losses = int(np.sum(valid[:-1] & ~valid[1:]))
    lasted = float(series.estimate.t[-1] - series.estimate.t[np.flatnonzero(valid)[-1]])
    if lasted > LOST_S:
        yield RunFinding(
            FAILED, f"the object is lost at the end: no valid estimate in the last {lasted:.1f} s ({reasons})",
            "; ".join(filter(None, (again, f"palmd why {run} if the motion was held"))),
        )  # fmt: skip
    if share < MIN_VALID_FRACTION:
        yield RunFinding(
            IMPAIRED, f"after the first valid estimate {share:.0%} of the estimates are valid (usual: "
            f"{MIN_VALID_FRACTION:.0%} or more), lost {losses} times; reasons: {reasons}",
            "see Consistency below; possible causes: a flat side, a corner, two objects or a moved pad",
        )  # fmt: skip


def _in_words(code: str) -> str:
    """A code unchanged, or as words if it was made from a sentence."""
    return code if code.count("-") < PHRASE_HYPHENS else code.replace("-", " ")


# ---------------------------------------------------------------------------------------------------------- the rest


def _of_faults(series: Series) -> Iterator[RunFinding]:
    """One finding per fault code that degraded, held or stopped, the most frequent first."""
    by_code: dict[str, list[FaultInterval]] = {}
    for fault in series.faults:
        if fault.severity in _LEVEL_OF:
            by_code.setdefault(fault.code, []).append(fault)
    for code, intervals in sorted(by_code.items(), key=lambda item: -len(item[1])):
        seconds = sum(each.end - each.begin for each in intervals)
        times = f"{len(intervals)} times" if len(intervals) > 1 else "once"
        what = (
            f"{code} ({intervals[0].severity}) {times}, {seconds:.1f} s in total, first at {intervals[0].begin:.1f} s"
        )
        yield RunFinding(_LEVEL_OF[intervals[0].severity], what, intervals[0].hint)


def _of_ratios(ratios: tuple[TestRatio, ...]) -> Iterator[RunFinding]:
    for each in ratios:
        if each.ratio > 1.0:
            value = f"{each.value:.3g} {each.unit}".rstrip()
            yield RunFinding(
                IMPAIRED,
                f"{each.name}: {value}, {each.ratio:.1f} times its limit of {each.limit:.3g}",
                _ACTIONS[each.name],
            )  # fmt: skip


def _of_errors(series: Series, errors: Errors | None) -> Iterator[RunFinding]:
    if errors is None or not series.valid.any():
        return
    for name in errors.error:
        within, judged = count_within_band(series, errors, name)
        share = within / judged if judged else math.nan
        if math.isfinite(share) and share < MIN_WITHIN_FRACTION:
            yield RunFinding(
                IMPAIRED, f"{share:.0%} of the errors of {name} against the truth are within {SDS:g} standard "
                "deviations (95 % of normal errors would be)",
                "the standard deviations are too small here: report it with palmd bundle",
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
            "reduce the load of the recording machine",
        )
    for text in series.rig_deviations or ():
        what, _, action = text.partition(": ")
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
    _FORCE: "check what lies on the pads; lower the plan's accelerations",
    _FOLLOWING: "lower the plan's rates and accelerations; check the arm",
    _LATE: "palmd doctor latency, and reduce the load of this machine",
    _WORK: "palmd doctor build compiles the observers",
    _SKIPPED: "palmd doctor latency, and reduce the load of this machine",
}
MAX_SKIPPED_FRACTION = 0.001
MAX_LATENESS, MAX_WORK = 0.2, 0.5
"""Largest lateness and work of a tick, as fractions of the period."""


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
        for name, column, share in ((_LATE, "lateness_p99_ms", MAX_LATENESS), (_WORK, "work_p99_ms", MAX_WORK)):
            values = _finite(series.loop[column])
            if len(values):
                yield TestRatio(name, float(values.max()), share * period_ms, "ms")
        if series.counts.get("ticks"):
            yield TestRatio(_SKIPPED, series.counts["overruns"] / series.counts["ticks"], MAX_SKIPPED_FRACTION)


def _force_limit(series: Series) -> float:
    """The smallest force limit in the run's `palm/info`; NaN if it has none."""
    for message in series.run.messages(series.run.topics.info.name):
        found = message.fields.get("force_limit_n", math.nan)
        limits = found if isinstance(found, list) else [found]
        return min((float(each) for each in limits), default=math.nan)
    return math.nan


def _finite(values: FloatArray) -> FloatArray:
    return np.asarray(values[np.isfinite(values)])
