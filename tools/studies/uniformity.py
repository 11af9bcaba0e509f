"""Test whether ranks of the truth in posteriors are uniform: mean and sd of z, shares within 1σ, and a test. Pure.

If a posterior is right its z are standard normal and the ranks Φ(z) uniform. A sd of z above 1 means that the band is
too narrow, one below 1 that it is too wide; a nonzero mean is a bias. Ranks are compared with the uniform distribution
by the Kolmogorov–Smirnov test, for each quantity over the independent runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from palmd.console.columns import aligned
from palmd.events import FloatArray

SIGNIFICANCE = 0.01  # for all quantities of a table together, by Bonferroni
CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Uniformity:
    """Statistics of the z of one quantity: number, mean, sd, shares within 1, 2 and 3, and the test of their ranks.

    distance: largest distance of the ranks' distribution from the uniform one; p: probability of a larger distance.
    """

    runs: int
    mean: float
    sd: float
    within: tuple[float, float, float]
    distance: float
    p: float

    @classmethod
    def of(cls, z: FloatArray) -> Uniformity:
        """The statistics of at least one z."""
        test = stats.kstest(stats.norm.cdf(z), "uniform")
        one, two, three = (float(np.mean(np.abs(z) <= limit)) for limit in (1.0, 2.0, 3.0))
        return cls(
            len(z), float(z.mean()), float(z.std()), (one, two, three), float(test.statistic), float(test.pvalue)
        )


def at_most(part: int, of: int) -> float:
    """Upper confidence limit of the share, at level `CONFIDENCE` (Clopper and Pearson)."""
    return 1.0 if part == of else float(stats.beta.ppf(CONFIDENCE, part + 1, of - part))


def non_uniform(found: dict[str, Uniformity]) -> list[str]:
    """Quantities whose ranks are not uniform, at level `SIGNIFICANCE` for all together."""
    return [name for name, each in found.items() if each.p < SIGNIFICANCE / len(found)]


def table(found: dict[str, Uniformity]) -> str:
    """A line for each quantity, marked if its ranks are not uniform."""
    marked = non_uniform(found)
    head = ("", ["runs", "mean z", "sd z", "≤ 1 sd %", "≤ 2 sd %", "≤ 3 sd %", "KS", "p", ""])
    right = stats.norm.cdf([1.0, 2.0, 3.0]) * 2.0 - 1.0
    expected = ("standard normal", ["", "0", "1", *(f"{100.0 * share:.1f}" for share in right), "", "", ""])
    return aligned([head, expected, *((name, _cells(each, name in marked)) for name, each in found.items())])


def _cells(found: Uniformity, marked: bool) -> list[str]:
    shares = [f"{100.0 * share:.1f}" for share in found.within]
    numbers = [f"{found.mean:+.2f}", f"{found.sd:.2f}", *shares, f"{found.distance:.3f}", f"{found.p:.2g}"]
    return [str(found.runs), *numbers, "not uniform" if marked else ""]
