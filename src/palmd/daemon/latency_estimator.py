"""Estimator of the latency between the arm and its set-points, running while it moves. Pure, and safe in the loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

from palmd.events import Joints, PalmMotion

START_S, LONGEST_S = 0.040, 0.100
MEMORY = 24  # set-points: 0.38 s at 16 ms
FORGETTING = 0.995  # per report: a memory of some 3 s
PRIOR_INFORMATION = 0.01  # (1 mrad of misfit / 10 ms of lag)²; a report adds the information ω²


class LatencyEstimator:
    """Stores recent set-points and fits the lag L in actual(t) ≈ commanded(t − L).

    To first order actual(t) − commanded(t − L) = −ω·δ if L is wrong by δ, so L is estimated by recursive least squares
    with forgetting; an arm at rest adds no information and forgets none.
    """

    def __init__(self) -> None:
        self.lag_s = START_S
        self._sent: deque[tuple[float, PalmMotion]] = deque(maxlen=MEMORY)
        self._information = PRIOR_INFORMATION

    def sent(self, t: float, motion: PalmMotion) -> None:
        """A set-point was sent at `t` (s), later than the one before."""
        self._sent.append((t, motion))

    def forget(self) -> None:
        """Tracking has ended: drop the set-points, which no longer describe the motion. The lag is kept."""
        self._sent.clear()

    def motion(self, t_sample: float) -> PalmMotion | None:
        """The commanded motion at `t_sample` (s), delayed by the lag; None where nothing was commanded."""
        return self._commanded(t_sample - self.lag_s)

    def observe(
        self, t_sample: float, angles: Joints, free: Collection[int] = (), planned: PalmMotion | None = None
    ) -> None:
        """Update the lag from the actual joint angles (rad) at `t_sample` (s), except those of `free` joints.

        planned: the result of `motion(t_sample)` if it is already available.
        """
        planned = planned or self.motion(t_sample)
        if planned is None:
            return
        rates = [0.0 if joint in free else omega for joint, omega in enumerate(planned.rates)]
        speed = sum(omega**2 for omega in rates)
        each = zip(rates, angles, planned.angles, strict=True)
        misfit = sum(omega * (actual - commanded) for omega, actual, commanded in each)
        self._information = max(FORGETTING * self._information, PRIOR_INFORMATION) + speed
        self.lag_s = min(max(self.lag_s - misfit / self._information, 0.0), LONGEST_S)

    def fastest(self, since: float, joints: int) -> list[float]:
        """The largest commanded absolute rate of each joint since `since` (s)."""
        rates = []
        for t, motion in reversed(self._sent):
            rates.append(motion.rates)
            if t < since:
                break
        return [max(max(each), -min(each)) for each in zip(*rates, strict=True)] if rates else [0.0] * joints

    def extremes(self, t_sample: float, within_s: float) -> tuple[Joints, Joints]:
        """Least and largest commanded angle of each joint at `t_sample` (s), for lag errors up to `within_s`.

        Call only where `motion` is not None.
        """
        at = t_sample - self.lag_s
        ends = self._commanded(at - within_s), self._commanded(at + within_s)
        planned = [motion.angles for motion in ends if motion is not None]
        planned += [motion.angles for t, motion in self._sent if abs(t - at) < within_s]
        each = list(zip(*planned, strict=True))
        return tuple(map(min, each)), tuple(map(max, each))

    def _commanded(self, t: float) -> PalmMotion | None:
        """Linear interpolation between set-points, constant after the last; None before the first."""
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
