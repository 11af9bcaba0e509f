"""Whether ranks of the truth in posteriors are uniform: mean and sd of z, shares within 1σ, and a test. Pure.

Where a posterior is right its z are standard normal and the ranks Φ(z) uniform. A sd of z above 1 is a band too narrow,
one below 1 a band too wide, a mean that is not 0 a bias. Ranks are compared with uniform ones by Kolmogorov and
Smirnov's test, each quantity by itself over the runs, which are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from palmd.console.columns import aligned
from palmd.events import FloatArray

SIGNIFICANCE = 0.01  # of all the ranks of a table together, by Bonferroni
CONFIDENCE = 0.95


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


def at_most(such: int, of: int) -> float:
    """Upper limit of the share that there may be, with `CONFIDENCE` (Clopper and Pearson)."""
    return 1.0 if such == of else float(stats.beta.ppf(CONFIDENCE, such + 1, of - such))


def crooked(found: dict[str, Uniformity]) -> list[str]:
    """The quantities whose ranks are not uniform, at `SIGNIFICANCE` for all of them together."""
    return [name for name, each in found.items() if each.p < SIGNIFICANCE / len(found)]


def table(found: dict[str, Uniformity]) -> str:
    """A line for each quantity, marked where its ranks are not uniform."""
    marked = crooked(found)
    head = ("", ["runs", "mean z", "sd z", "≤ 1 sd %", "≤ 2 sd %", "≤ 3 sd %", "KS", "p", ""])
    right = stats.norm.cdf([1.0, 2.0, 3.0]) * 2.0 - 1.0
    expected = ("standard normal", ["", "0", "1", *(f"{100.0 * share:.1f}" for share in right), "", "", ""])
    return aligned([head, expected, *((name, _cells(each, name in marked)) for name, each in found.items())])


def _cells(found: Uniformity, marked: bool) -> list[str]:
    shares = [f"{100.0 * share:.1f}" for share in found.within]
    numbers = [f"{found.mean:+.2f}", f"{found.sd:.2f}", *shares, f"{found.distance:.3f}", f"{found.p:.2g}"]
    return [str(found.runs), *numbers, "not uniform" if marked else ""]
