"""The reaction to an injected fault, measured from the messages of daemon and rig and judged by its row. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

from palmd.console.columns import aligned
from tools.studies.fault_rows import HOST_ALIVE_S, HOST_DEAD_S, FaultRow
from tools.studies.root_cause import Judgement, enough

STANDING_RAD_S = math.radians(0.5)
"""Palms that turn slower than this are at rest; a fast plan turns them by 30 to 60 °/s."""

GRAVE = {"hold": "hold", "stop": "fault"}
"""The severities that stop motion, and the states they lead to."""

_RANK = ("idle", "tracking", "ready", "hold", "fault")


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """The true motion of the palms at `t` (s), from the rig: angles (rad) and rates (rad/s) of both."""

    t: float
    phi: tuple[float, float]
    omega: tuple[float, float]

    @property
    def standing(self) -> bool:
        """Whether both palms are at rest."""
        return max(map(abs, self.omega)) < STANDING_RAD_S


@dataclass(frozen=True, slots=True)
class StateReport:
    """One `palm/state` message: its time (s), the state, and the active faults with their severities."""

    t: float
    state: str
    faults: dict[str, str]

    @classmethod
    def of(cls, fields: Mapping[str, Any], t: float) -> StateReport:
        """From the fields of `palm/state`."""
        return cls(t, fields["state"], dict(zip(fields["faults"], fields["severities"], strict=True)))


@dataclass(frozen=True, slots=True)
class Reaction:
    """The reaction to a cause; times in seconds from the cause, NaN for what did not happen.

    `state`: the most severe state that was reached, at `came_s`. `noticed_s`: when the first of the row's faults was
    reported. `still_s`: when the arm had come to rest; `turned_rad`: by how much a palm had turned until then. `wrong`:
    other deviations. `starved`: the machine delayed the rig meanwhile. `why`: the answer of `palmd why`, None before.
    """

    faults: dict[str, str]
    state: str
    noticed_s: float = math.nan
    still_s: float = math.nan
    turned_rad: float = math.nan
    wrong: tuple[str, ...] = ()
    starved: bool = False
    came_s: float = math.nan
    why: Judgement | None = None


@dataclass(slots=True)
class ReactionWatch:
    """Collects messages of daemon and rig; `reaction` evaluates those after the cause."""

    states: list[StateReport] = field(default_factory=list)
    motions: list[TrueMotion] = field(default_factory=list)

    def take(self, topic: str, fields: dict[str, Any]) -> None:
        """Take one message of either."""
        t = fields["mono_ns"] * 1e-9
        if topic == "palm/state":
            self.states.append(StateReport.of(fields, t))
        elif topic == "rig/truth":
            phi, omega = ((fields[f"{name}1_{unit}"], fields[f"{name}2_{unit}"]) for name, unit in _MOTION_FIELDS)
            self.motions.append(TrueMotion(t, phi, omega))

    def reaction(self, row: FaultRow, t_cause: float, wrong: Sequence[str] = (), *, starved: bool = False) -> Reaction:
        """The reaction to the cause at `t_cause` (s) up to now."""
        before = {code for report in self.states if report.t <= t_cause for code in report.faults} - row.codes
        after = [report for report in self.states if report.t > t_cause]
        faults = {code: kind for report in after for code, kind in report.faults.items() if code not in before}
        noticed = next((report.t - t_cause for report in after if row.codes & report.faults.keys()), math.nan)
        state = max((report.state for report in after), key=_severity_rank, default="")
        came = next((report.t - t_cause for report in after if report.state == state), math.nan)
        still_s, turned = standstill([one for one in self.motions if one.t >= t_cause], t_cause)
        return Reaction(faults, state, noticed, still_s, turned, tuple(wrong), starved, came)


_MOTION_FIELDS = (("phi", "rad"), ("omega", "rad_s"))


def _severity_rank(state: str) -> int:
    return _RANK.index(state) if state in _RANK else -1


def standstill(motions: Sequence[TrueMotion], t_cause: float) -> tuple[float, float]:
    """Time (s from `t_cause`) from which the palms stayed at rest, and how far one had turned (rad); NaN if never."""
    still = math.nan
    at = None
    for one in reversed(motions):
        if not one.standing:
            break
        still, at = one.t - t_cause, one
    if at is None:
        return math.nan, math.nan
    return still, max(abs(a - b) for a, b in zip(at.phi, motions[0].phi, strict=True))


def complete(row: FaultRow, reaction: Reaction) -> bool:
    """Whether everything that the row expects has happened."""
    stands = reaction.state == "tracking" or not math.isnan(reaction.still_s)
    return row.codes <= reaction.faults.keys() and reaction.state == row.state and stands


def differences(row: FaultRow, reaction: Reaction) -> list[str]:
    """Deviations from the row, in words; empty if there are none."""
    found = [
        f"{code} is {reaction.faults[code]}, not {severity}" if code in reaction.faults else f"no {code}"
        for code, severity in row.faults
        if reaction.faults.get(code) != severity
    ]
    grave = {code for code, severity in reaction.faults.items() if severity in GRAVE}
    found += [f"unexpected {code}" for code in sorted(grave - row.codes - set(row.may))]
    allowed = {row.state} | {GRAVE[reaction.faults[code]] for code in grave & set(row.may)}
    if reaction.state not in allowed:
        found.append(f"state {reaction.state or 'not reported'}, not {row.state}")
    if reaction.state != "tracking" and math.isnan(reaction.still_s):
        found.append("the arm did not come to rest")
    return found + list(reaction.wrong)


# -------------------------------------------------------------------------------------------------- in words


def as_line(row: FaultRow, reaction: Reaction) -> dict[str, Any]:
    """One provocation for JSON; null for what did not happen, and for an arm that need not stop."""
    stopped = _stopped(reaction)
    return {
        "name": row.name,
        "cause": row.cause,
        "expected": {"state": row.state, "faults": dict(row.faults)},
        "observed": {"state": reaction.state, "faults": reaction.faults},
        "noticed_ms": _ms_or_none(reaction.noticed_s),
        "still_ms": _ms_or_none(reaction.still_s) if stopped else None,
        "goal_ms": round(row.goal_s * 1e3) if stopped and math.isfinite(row.goal_s) else None,
        "turned_deg": _rounded(math.degrees(reaction.turned_rad)) if stopped else None,
        "starved": reaction.starved,
        "why": None if reaction.why is None else asdict(reaction.why),
        "differs": differences(row, reaction),
    }


def table(results: Sequence[tuple[FaultRow, Sequence[Reaction]]]) -> str:
    """One line for each row: expected and observed reaction, medians of the times (ms), verdict."""
    head = ("row", ("expected", "observed", "noticed", "still", "worst", "goal", "why", "verdict"))
    return aligned([head, *((row.name, _cells(row, reactions)) for row, reactions in results)])


def summary(results: Sequence[tuple[FaultRow, Sequence[Reaction]]]) -> str:
    """Number of rows as promised, and times to standstill."""
    right = sum(not any(differences(row, one) for one in reactions) for row, reactions in results)
    lines = [f"{right} of {len(results)} rows did as promised"]
    for goal_s, condition in ((HOST_ALIVE_S, "host alive"), (HOST_DEAD_S, "host dead")):
        times = [one.still_s for row, some in results if row.goal_s == goal_s for one in some if _stopped(one)]
        if times:
            within = sum(time <= goal_s for time in times)
            lines.append(
                f"cause to standstill, {condition}: median {_ms(median(times))} ms, worst {_ms(max(times))} ms; "
                f"{within} of {len(times)} within {_ms(goal_s)} ms"
            )
    judged = judgements(results)
    if judged:
        full, bare = (sum(each) for each in zip(*((one.right, one.right_without_log) for one in judged), strict=True))
        spoilt = sum(len(some) for _, some in results) - len(judged)
        share = f"{full} of {len(judged)} provocations, without palm/log for {bare}"
        lines.append(f"palmd why is right for {share}; {spoilt} were spoilt")
    return "\n".join(lines)


def _cells(row: FaultRow, reactions: Sequence[Reaction]) -> list[str]:
    codes = {code for one in reactions for code in one.faults if one.faults[code] in GRAVE or code in row.codes}
    found = sorted({one.state for one in reactions}, key=_severity_rank)
    differs = [what for one in reactions for what in differences(row, one)]
    still = [one.still_s for one in reactions if _stopped(one)]
    noticed = [one.noticed_s for one in reactions if not math.isnan(one.noticed_s)]
    return [
        " ".join([row.state, *sorted(row.codes)]),
        " ".join([*found, *sorted(codes)]),
        _ms(median(noticed)) if noticed else "-",
        _ms(median(still)) if still else "-",
        _ms(max(still)) if still else "-",
        _ms(row.goal_s) if still and math.isfinite(row.goal_s) else "-",
        _why(reactions),
        "; ".join(dict.fromkeys(differs)) or "as promised",
    ]


def judgements(results: Iterable[tuple[FaultRow, Sequence[Reaction]]]) -> list[Judgement]:
    """The answers of `palmd why` for provocations without deviations; spoilt ones, with another cause, are excluded."""
    return [
        one.why
        for row, some in results
        for one in some
        if one.why is not None and not one.why.spoilt and not differences(row, one)
    ]


def _why(reactions: Sequence[Reaction]) -> str:
    """The answers of `palmd why`, and how many of them are right."""
    judged = [one.why for one in reactions if one.why is not None]
    names = ", ".join(dict.fromkeys(one.with_log for one in judged))
    return f"{sum(one.right for one in judged)}/{len(judged)} {names}" if judged else "-"


def _stopped(reaction: Reaction) -> bool:
    return reaction.state != "tracking" and not math.isnan(reaction.still_s)


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.0f}"


def _ms_or_none(seconds: float) -> float | None:
    return _rounded(seconds * 1e3)


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 1)


def all_as_promised(results: Iterable[tuple[FaultRow, Sequence[Reaction]]]) -> bool:
    """Whether no row deviates, and `palmd why` is right often enough."""
    results = [*results]
    return enough(judgements(results)) and not any(differences(row, one) for row, some in results for one in some)
