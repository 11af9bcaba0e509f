"""What many runs come to: the goals of the study, for each kind of run, and a table of them. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from palmd.console.columns import aligned
from palmd.rig.shapes import KINDS, Kind
from tools.studies.scoring import Causal, MonteCarloRow, Scalar

CAUSAL_GOAL_S = 6.0
_NOTHING = "–"


@dataclass(frozen=True, slots=True)
class Percentiles:
    """Median, 90th and 95th percentile."""

    median: float
    p90: float
    p95: float


@dataclass(frozen=True, slots=True)
class Parameter:
    """Of one parameter: medians of |error| over the true value and of sd over bound, share of errors within 2 sd."""

    relative_error: float
    within_2_sd: float
    sd_over_bound: float


@dataclass(frozen=True, slots=True)
class CausalSummary:
    """Of the causal replays: `within_goal` is the share converged for good within `CAUSAL_GOAL_S`."""

    converged_after_s: Percentiles
    within_goal: float
    first_valid_s: float
    r_rms_m: float
    nees_r: float


@dataclass(frozen=True, slots=True)
class Summary:
    """All runs of one kind. Where no percentiles are told, a number is the median, or a count or share of runs.

    A run without an outline counts as infinitely far off in `e_h` and `max_error`, one that never converged as
    infinitely late; other medians are over the runs that have the number.
    """

    kind: Kind
    runs: int
    errors: int
    right: float
    converged: float
    wrong: int
    e_h_m: Percentiles
    max_error_m: Percentiles
    touched: float
    efficiency: float
    nees_h: float
    psi_rms_rad: float
    omega0_rms_rad_s: float
    rho: Parameter
    mu: Parameter
    mass: Parameter
    seconds: Percentiles
    causal: CausalSummary | None


def summaries(rows: Sequence[MonteCarloRow]) -> list[Summary]:
    """One for each kind of which there are runs."""
    kinds = [(kind, [row for row in rows if row.kind == kind]) for kind in KINDS]
    return [_summary(kind, of_kind) for kind, of_kind in kinds if of_kind]


def quantile(values: Iterable[float], q: float) -> float:
    """The q-quantile, linear between neighbours as long as they are finite; NaN of nothing."""
    ordered = sorted(values)
    if not ordered:
        return math.nan
    position = q * (len(ordered) - 1)
    low = math.floor(position)
    part = position - low
    if part == 0.0 or ordered[low] == ordered[low + 1]:
        return ordered[low]
    return ordered[low] + part * (ordered[low + 1] - ordered[low])


def _summary(kind: Kind, rows: Sequence[MonteCarloRow]) -> Summary:
    return Summary(
        kind=kind,
        runs=len(rows),
        errors=sum(bool(row.error) for row in rows),
        right=_share(row.right for row in rows),
        converged=_share(row.converged for row in rows),
        wrong=sum(row.wrong for row in rows),
        e_h_m=_spread(_or_worst(row.e_h_m for row in rows)),
        max_error_m=_spread(_or_worst(row.max_error_m for row in rows)),
        touched=_median(row.touched for row in rows),
        efficiency=_median(row.efficiency for row in rows),
        nees_h=_median(row.nees_h for row in rows),
        psi_rms_rad=_median(row.psi_rms_rad for row in rows),
        omega0_rms_rad_s=_median(row.omega0_rms_rad_s for row in rows),
        rho=_parameter([row.rho_m for row in rows]),
        mu=_parameter([row.mu for row in rows]),
        mass=_parameter([row.mass_kg for row in rows]),
        seconds=_spread(_known(row.seconds for row in rows)),
        causal=_causal([row.causal for row in rows]),
    )


def _parameter(values: Sequence[Scalar]) -> Parameter:
    return Parameter(
        relative_error=_median(value.relative_error for value in values),
        within_2_sd=_share(
            abs(value.error) <= 2.0 * value.sd for value in values if math.isfinite(value.error + value.sd)
        ),
        sd_over_bound=_median(value.sd / value.bound for value in values if value.bound),
    )


def _causal(replays: Sequence[Causal | None]) -> CausalSummary | None:
    """Over all runs: one that came to nothing has not converged either."""
    done = [each for each in replays if each is not None]
    if not done:
        return None
    after = [math.inf] * (len(replays) - len(done)) + _or_worst(each.converged_after_s for each in done)
    return CausalSummary(
        converged_after_s=_spread(after),
        within_goal=_share(t <= CAUSAL_GOAL_S for t in after),
        first_valid_s=_median(each.first_valid_s for each in done),
        r_rms_m=_median(each.r_rms_m for each in done),
        nees_r=_median(each.nees_r for each in done),
    )


def _known(values: Iterable[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _or_worst(values: Iterable[float]) -> list[float]:
    return [value if math.isfinite(value) else math.inf for value in values]


def _median(values: Iterable[float]) -> float:
    return quantile(_known(values), 0.5)


def _spread(values: Sequence[float]) -> Percentiles:
    return Percentiles(*(quantile(values, q) for q in (0.5, 0.9, 0.95)))


def _share(marks: Iterable[bool]) -> float:
    told = list(marks)
    return sum(told) / len(told) if told else math.nan


# ------------------------------------------------------------------------------------------------- shown


def table(told: Sequence[Summary]) -> str:
    """The summaries side by side, a line for each number; ∞ where too many runs have none, – where there is none."""
    lines: list[tuple[str, list[str]]] = [("", [summary.kind for summary in told])]
    lines += [(name, [show(summary) for summary in told]) for name, show in _LINES]
    causal = [summary.causal for summary in told]
    if any(causal):
        lines += [(name, [show(each) if each else _NOTHING for each in causal]) for name, show in _CAUSAL_LINES]
    return aligned(lines)


def remarks(rows: Sequence[MonteCarloRow]) -> list[str]:
    """The runs to look at: a line for each that claims what is wrong, or came to nothing."""
    return [
        f"{row.kind} {row.seed}: {row.error or f'claimed but wrong by {row.e_h_m * 1e6:.0f} µm'}"
        for row in rows
        if row.error or row.wrong
    ]


def number(value: float, unit: float = 1.0) -> str:
    if math.isnan(value):
        return _NOTHING
    if math.isinf(value):
        return "∞"
    scaled = value * unit
    return f"{scaled:.0f}" if abs(scaled) >= 100.0 else f"{scaled:.3g}"


def percent(value: float) -> str:
    return _NOTHING if math.isnan(value) else f"{100.0 * value:.1f}"


def _three(spread: Percentiles, unit: float = 1.0) -> str:
    return " / ".join(number(value, unit) for value in (spread.median, spread.p90, spread.p95))


def _parameter_lines(name: str, of: Callable[[Summary], Parameter]) -> list[tuple[str, Callable[[Summary], str]]]:
    return [
        (f"{name}: |error|, median (%)", lambda s: number(of(s).relative_error, 100.0)),
        (f"{name}: within 2 sd (%)", lambda s: percent(of(s).within_2_sd)),
        (f"{name}: sd / bound, median", lambda s: number(of(s).sd_over_bound)),
    ]


_LINES: list[tuple[str, Callable[[Summary], str]]] = [
    ("runs", lambda s: str(s.runs)),
    ("ended in an error", lambda s: str(s.errors)),
    ("right: e_h < 0.1 mm (%)", lambda s: percent(s.right)),
    ("converged (%)", lambda s: percent(s.converged)),
    ("claimed but wrong: e_h > 0.3 mm", lambda s: str(s.wrong)),
    ("e_h, median / p90 / p95 (µm)", lambda s: _three(s.e_h_m, 1e6)),
    ("largest error, median / p90 / p95 (µm)", lambda s: _three(s.max_error_m, 1e6)),
    ("touched normals, median (%)", lambda s: percent(s.touched)),
    ("efficiency: bound / e_h, median", lambda s: number(s.efficiency)),
    ("(error / sd)² of h, median", lambda s: number(s.nees_h)),
    ("ψ RMS, median (mrad)", lambda s: number(s.psi_rms_rad, 1e3)),
    ("ω0 RMS, median (mrad/s)", lambda s: number(s.omega0_rms_rad_s, 1e3)),
    *_parameter_lines("ρ", lambda s: s.rho),
    *_parameter_lines("μ", lambda s: s.mu),
    *_parameter_lines("mass", lambda s: s.mass),
    ("reconstruct, median / p90 / p95 (s)", lambda s: _three(s.seconds)),
]

_CAUSAL_LINES: list[tuple[str, Callable[[CausalSummary], str]]] = [
    ("causal: right for good after, median / p90 / p95 (s)", lambda c: _three(c.converged_after_s)),
    (f"causal: within {CAUSAL_GOAL_S:g} s (%)", lambda c: percent(c.within_goal)),
    ("causal: first valid after, median (s)", lambda c: number(c.first_valid_s)),
    ("causal: r1, r2 RMS in the last 5 s, median (µm)", lambda c: number(c.r_rms_m, 1e6)),
    ("causal: (error / sd)² of r1, r2, median", lambda c: number(c.nees_r)),
]
