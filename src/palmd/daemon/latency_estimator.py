"""The latency with which the arm follows its set-points, estimated while it moves. Pure, and safe in the loop."""

from __future__ import annotations

from collections import deque

from palmd.events import PalmMotion

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

    def observe(self, t_sample: float, phi1: float, phi2: float) -> None:
        """Learn from the actual palm angles (rad) at `t_sample` (s)."""
        meant = self.motion(t_sample)
        if meant is None:
            return
        speed = meant.omega1**2 + meant.omega2**2
        misfit = meant.omega1 * (phi1 - meant.phi1) + meant.omega2 * (phi2 - meant.phi2)
        self._information = max(FORGETTING * self._information, PRIOR_INFORMATION) + speed
        self.lag_s = min(max(self.lag_s - misfit / self._information, 0.0), LONGEST_S)

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
    return PalmMotion(
        a.phi1 + w * (b.phi1 - a.phi1),
        a.phi2 + w * (b.phi2 - a.phi2),
        a.omega1 + w * (b.omega1 - a.omega1),
        a.omega2 + w * (b.omega2 - a.omega2),
        a.alpha1 + w * (b.alpha1 - a.alpha1),
        a.alpha2 + w * (b.alpha2 - a.alpha2),
    )
