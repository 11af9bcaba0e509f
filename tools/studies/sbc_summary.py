"""Whether what many reconstructions believe is right: ranks, shares within one-sigmas, wrong claims; as tables. Pure.

Where a posterior is right its z are standard normal and the ranks Φ(z) uniform. A sd of z above 1 is a band too narrow,
one below 1 a band too wide, a mean that is not 0 a bias. Ranks are held against uniform ones by Kolmogorov and
Smirnov's test, each quantity by itself over the runs, which are independent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from palmd.console.columns import aligned
from palmd.events import FloatArray
from palmd.rig.shapes import KINDS
from palmd.score import WRONG_M
from tools.studies.sbc import CONSTANTS, SbcRow

SIGNIFICANCE = 0.01  # of all the ranks of a table together, by Bonferroni
MOST_SIGMAS = 6.0  # beyond which a claim is wrong, whatever its error
CONFIDENCE = 0.95
TOGETHER = "rig, together"


@dataclass(frozen=True, slots=True)
class Uniformity:
    """Of the z of one quantity: how many, their mean and sd, shares within 1, 2 and 3, and the test of their ranks.

    distance: the largest by which the ranks' distribution is not the uniform one; p: the chance of as large a distance.
    """

    runs: int
    mean: float
    sd: float
    within: tuple[float, float, float]
    distance: float
    p: float

    @classmethod
    def of(cls, z: FloatArray) -> Uniformity:
        """Of at least one z."""
        test = stats.kstest(stats.norm.cdf(z), "uniform")
        one, two, three = (float(np.mean(np.abs(z) <= limit)) for limit in (1.0, 2.0, 3.0))
        return cls(
            len(z), float(z.mean()), float(z.std()), (one, two, three), float(test.statistic), float(test.pvalue)
        )


@dataclass(frozen=True, slots=True)
class Count:
    """How many runs of how many are such."""

    such: int
    of: int

    @property
    def at_most(self) -> float:
        """Upper limit of the share that there may be, with `CONFIDENCE` (Clopper and Pearson)."""
        return 1.0 if self.such == self.of else float(stats.beta.ppf(CONFIDENCE, self.such + 1, self.of - self.such))


def claims(rows: Iterable[SbcRow]) -> list[SbcRow]:
    """The runs that claim to have converged."""
    return [row for row in rows if row.converged]


def wrong(row: SbcRow) -> bool:
    """Whether a touched normal is off by more than `WRONG_M` beyond its band."""
    return row.beyond_m > WRONG_M


def far(row: SbcRow, sigmas: float = MOST_SIGMAS) -> list[str]:
    """What is off by more than so many one-sigmas."""
    found = [name for name, belief in row.beliefs.items() if abs(belief.z) > sigmas]
    return [*found, "a touched normal"] if row.worst_z > sigmas else found


def uniformities(rows: Sequence[SbcRow]) -> dict[str, Uniformity]:
    """Of each quantity that a claim believes, the rig's constants together last."""
    claimed = claims(rows)
    names = dict.fromkeys(name for row in claimed for name in row.beliefs)
    all_z = {name: [row.beliefs[name].z for row in claimed if name in row.beliefs] for name in names}
    distances = np.array([row.rig_distance2 for row in claimed])
    all_z[TOGETHER] = stats.norm.isf(stats.chi2.sf(distances, len(CONSTANTS))).tolist()
    finite = {name: np.array(z)[np.isfinite(z)] for name, z in all_z.items()}
    return {name: Uniformity.of(z) for name, z in finite.items() if len(z)}


def crooked(told: dict[str, Uniformity]) -> list[str]:
    """The quantities whose ranks are not uniform, at `SIGNIFICANCE` for all of them together."""
    return [name for name, each in told.items() if each.p < SIGNIFICANCE / len(told)]


# ------------------------------------------------------------------------------------------------- shown


def report(rows: Sequence[SbcRow]) -> str:
    """For each kind of run and for all: seeds, claims, a line for each quantity; then the runs to look at."""
    kinds: list[tuple[str, Sequence[SbcRow]]] = [(kind, [row for row in rows if row.kind == kind]) for kind in KINDS]
    kinds = [each for each in kinds if each[1]]
    parts = [_of_kind(*each) for each in ([*kinds, ("all kinds", rows)] if len(kinds) > 1 else kinds)]
    return "\n\n".join(parts + ["\n".join(remarks(rows))] * bool(remarks(rows)))


def remarks(rows: Iterable[SbcRow]) -> list[str]:
    """A line for each run that came to nothing, claims what is wrong, or contradicts a rig that is as described."""
    return [f"{row.kind} {row.seed}: {remark}" for row in rows for remark in _remarks(row)]


def _remarks(row: SbcRow) -> list[str]:
    found = [row.error] if row.error else []
    if row.converged and wrong(row):
        found.append(f"claimed, and {row.beyond_m * 1e3:.2f} mm off beyond its band")
    if row.converged and far(row):
        found.append(f"claimed, and more than {MOST_SIGMAS:g} sd off: {', '.join(far(row))}")
    if row.contradicted:
        found.append("contradicted: " + ", ".join(f"{name} ({z:+.1f} sd)" for name, z in row.contradicted.items()))
    return found


def _of_kind(kind: str, rows: Sequence[SbcRow]) -> str:
    claimed = claims(rows)
    lines = [f"{kind}: seeds {seeds(row.seed for row in rows)}"]
    lines.append(f"  claimed: {len(claimed)} of {len(rows)}")
    refusals = Counter(row.error or row.reason for row in rows if not row.converged)
    lines += [f"  not claimed: {count}: {why}" for why, count in refusals.most_common()]
    lines += [
        f"  {what}: {_share(Count(sum(map(such, of)), len(of)))}" for what, such, of in _marks(rows, claimed) if of
    ]
    return "\n".join(lines) + ("\n" + table(uniformities(rows)) if claimed else "")


def _marks(
    rows: Sequence[SbcRow], claimed: Sequence[SbcRow]
) -> list[tuple[str, Callable[[SbcRow], bool], Sequence[SbcRow]]]:
    return [
        (f"claimed, a touched normal more than {WRONG_M * 1e3:g} mm off beyond its band", wrong, claimed),
        (f"claimed, anything more than {MOST_SIGMAS:g} sd off", lambda row: bool(far(row)), claimed),
        ("claimed, a touched normal more than 3 sd off", lambda row: row.worst_z > 3.0, claimed),
        ("a constant named contradicted", lambda row: bool(row.contradicted), rows),
    ]


def table(told: dict[str, Uniformity]) -> str:
    """A line for each quantity, marked where its ranks are not uniform."""
    marked = crooked(told)
    head = ("", ["claims", "mean z", "sd z", "≤ 1 sd %", "≤ 2 sd %", "≤ 3 sd %", "KS", "p", ""])
    right = stats.norm.cdf([1.0, 2.0, 3.0]) * 2.0 - 1.0
    expected = ("standard normal", ["", "0", "1", *(f"{100.0 * share:.1f}" for share in right), "", "", ""])
    return aligned([head, expected, *((name, _cells(each, name in marked)) for name, each in told.items())])


def _cells(told: Uniformity, marked: bool) -> list[str]:
    shares = [f"{100.0 * share:.1f}" for share in told.within]
    numbers = [f"{told.mean:+.2f}", f"{told.sd:.2f}", *shares, f"{told.distance:.3f}", f"{told.p:.2g}"]
    return [str(told.runs), *numbers, "not uniform" if marked else ""]


def seeds(numbers: Iterable[int]) -> str:
    """Whole numbers in words: those that follow each other as first–last."""
    parts: list[list[int]] = []
    for number in sorted(set(numbers)):
        if parts and number == parts[-1][-1] + 1:
            parts[-1].append(number)
        else:
            parts.append([number])
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]}–{part[-1]}" for part in parts)


def _share(count: Count) -> str:
    return (
        f"{count.such} of {count.of} (at most {100.0 * count.at_most:.2g} %, with {100.0 * CONFIDENCE:g} % confidence)"
    )
