"""The latency with which the arm follows its set-points, estimated while it moves. Pure, and safe in the loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

from palmd.events import Joints, PalmMotion

START_S, LONGEST_S = 0.040, 0.100
MEMORY = 24  # set-points: 0.38 s at 16 ms
FORGETTING = 0.995  # per report: a memory of some 3 s
PRIOR_INFORMATION = 0.01  # (1 mrad of misfit / 10 ms of lag)²: what a report says of the lag is ω² beside it


class LatencyEstimator:
    """Remembers what was commanded and when, and fits the lag L in actual(t) ≈ commanded(t − L).

    To first order actual(t) − commanded(t − L) = −ω·δ when L is wrong by δ, so L follows by recursive least
    squares with forgetting; a standing arm teaches nothing and does not unteach.
    """

    def __init__(self) -> None:
        self.lag_s = START_S
        self._sent: deque[tuple[float, PalmMotion]] = deque(maxlen=MEMORY)
        self._information = PRIOR_INFORMATION

    def sent(self, t: float, motion: PalmMotion) -> None:
        """A set-point went out at `t` (s), later than the one before."""
        self._sent.append((t, motion))

    def forget(self) -> None:
        """Tracking has ended: what was commanded no longer tells of the motion. The lag itself is kept."""
        self._sent.clear()

    def motion(self, t_sample: float) -> PalmMotion | None:
        """What the arm was meant to do at `t_sample` (s), the lag allowed for; None where not commanded."""
        return self._commanded(t_sample - self.lag_s)

    def observe(
        self, t_sample: float, angles: Joints, free: Collection[int] = (), meant: PalmMotion | None = None
    ) -> None:
        """Learn from the actual joint angles (rad) at `t_sample` (s), but of those that are `free` to go elsewhere.

        meant: what `motion` tells for then, where it has been asked already.
        """
        meant = meant or self.motion(t_sample)
        if meant is None:
            return
        rates = [0.0 if joint in free else omega for joint, omega in enumerate(meant.rates)]
        speed = sum(omega**2 for omega in rates)
        each = zip(rates, angles, meant.angles, strict=True)
        misfit = sum(omega * (actual - wanted) for omega, actual, wanted in each)
        self._information = max(FORGETTING * self._information, PRIOR_INFORMATION) + speed
        self.lag_s = min(max(self.lag_s - misfit / self._information, 0.0), LONGEST_S)

    def fastest(self, since: float, joints: int) -> list[float]:
        """The largest rate of each joint, without its sign, that has been commanded since then (s)."""
        rates = []
        for t, motion in reversed(self._sent):
            rates.append(motion.rates)
            if t < since:
                break
        return [max(max(each), -min(each)) for each in zip(*rates, strict=True)] if rates else [0.0] * joints

    def extremes(self, t_sample: float, within_s: float) -> tuple[Joints, Joints]:
        """Least and largest angle of each joint that was commanded for `t_sample` (s), where `motion` tells one.

        within_s: what the lag may be off by.
        """
        at = t_sample - self.lag_s
        ends = self._commanded(at - within_s), self._commanded(at + within_s)
        meant = [motion.angles for motion in ends if motion is not None]
        meant += [motion.angles for t, motion in self._sent if abs(t - at) < within_s]
        each = list(zip(*meant, strict=True))
        return tuple(map(min, each)), tuple(map(max, each))

    def _commanded(self, t: float) -> PalmMotion | None:
        """Linear between set-points, the last one from then on; None before the first."""
        after: tuple[float, PalmMotion] | None = None
        for entry in reversed(self._sent):
            if entry[0] <= t:
                return entry[1] if after is None else _between(entry, after, t)
            after = entry
        return None


def _between(before: tuple[float, PalmMotion], after: tuple[float, PalmMotion], t: float) -> PalmMotion:
    (t0, a), (t1, b) = before, after
    w = (t - t0) / (t1 - t0) if t1 > t0 else 1.0
    angles, rates, accelerations = (
        tuple(x + w * (y - x) for x, y in zip(one, other, strict=True))
        for one, other in ((a.angles, b.angles), (a.rates, b.rates), (a.accelerations, b.accelerations))
    )
    return PalmMotion(angles, rates, accelerations)
