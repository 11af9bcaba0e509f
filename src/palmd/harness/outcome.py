"""What came of a run without wires: the estimates against the truth, and what reached the arm. Pure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from palmd.events import FloatArray
from palmd.harness.wireless import Instant, Wireless
from palmd.messages import Fields
from palmd.quantities import ESTIMATE, SHAPE
from palmd.rig.world import World
from palmd.score import score_outline

WRONG_M = 3e-4
"""An r farther off than this is wrong."""

LAST_S = 5.0
_COMPARED = ("r1_m", "r2_m", "omega0_rad_s")


@dataclass(frozen=True, slots=True)
class Outcome:
    """A run in numbers, SI; NaN for what there is not.

    t_settled: from the plan's start to the first valid tick (s). valid: share of the ticks since then.
    wrong: share of the valid ticks with r1 or r2 off by more than `WRONG_M`. r_rms, omega0_rms: over the valid
    ticks of the run's last `LAST_S`. e_h, touched: the last valid outline's score. rho_error, mass_error: relative,
    mu_error absolute, of the last valid tick. objects: how often the observer began anew. outside_limits,
    largest_rate (rad/s): of the set-points as heard at the far end.
    """

    seed: int
    kind: str
    t_settled: float
    valid: float
    wrong: float
    r_rms: float
    omega0_rms: float
    e_h: float
    touched: float
    rho_error: float
    mu_error: float
    mass_error: float
    objects: int
    contact_losses: int
    falls: int
    outside_limits: int
    largest_rate: float

    @property
    def settled(self) -> bool:
        """Whether any tick was called valid."""
        return not math.isnan(self.t_settled)


def conclude(wireless: Wireless, duration_s: float) -> Outcome:
    """Start the plan, let it run for so many seconds, stop; raises WirelessError when that cannot be done."""
    wireless.start()
    judge = Judge(wireless.t)
    for instant in wireless.run(duration_s):
        judge.take(instant)
    wireless.stop()
    return judge.outcome(wireless.world)


class Judge:
    """Takes the ticks of a run one by one; needs the same memory however long it is."""

    def __init__(self, t_started: float) -> None:
        """The plan was started at `t_started` (s)."""
        self._t_started = self._t = t_started
        self._t_settled = math.nan
        self._ticks = self._valid = self._wrong = 0
        self._errors: deque[tuple[float, ...]] = deque()  # t and the errors of `_COMPARED`, the last `LAST_S`
        self._estimate: Fields = {}
        self._last_valid: Fields | None = None
        self._shape: Fields | None = None

    def take(self, instant: Instant) -> None:
        """One tick."""
        self._t = instant.t
        while self._errors and self._errors[0][0] <= self._t - LAST_S:
            self._errors.popleft()
        estimate = self._estimate = instant.messages[ESTIMATE.name]
        if estimate["valid"]:
            if self._last_valid is None:
                self._t_settled = instant.t
            self._last_valid = estimate
            self._shape = instant.messages.get(SHAPE.name, self._shape)
            errors = [estimate[name] - instant.truth[name] for name in _COMPARED]
            self._errors.append((instant.t, *errors))
            self._valid += 1
            self._wrong += max(map(abs, errors[:2])) > WRONG_M
        self._ticks += self._last_valid is not None

    def outcome(self, world: World) -> Outcome:
        """What came of it; the object on the palms must be the one they were asked about."""
        status, body = world.status(), world.object_truth()
        last = self._last_valid or dict.fromkeys(("rho_m", "mu", "mass_kg"), math.nan)
        e_h, touched = self._outline(np.array(body["h_m"]))
        r_rms, omega0_rms = self._rms()
        return Outcome(
            seed=world.seed,
            kind=world.kind,
            t_settled=self._t_settled - self._t_started,
            valid=_share(self._valid, self._ticks),
            wrong=_share(self._wrong, self._valid),
            r_rms=r_rms,
            omega0_rms=omega0_rms,
            e_h=e_h,
            touched=touched,
            rho_error=last["rho_m"] / body["rho_m"] - 1.0,
            mu_error=last["mu"] - body["mu"],
            mass_error=last["mass_kg"] / body["mass_kg"] - 1.0,
            objects=self._estimate.get("object", 0),
            contact_losses=status["contact_losses"],
            falls=status["falls"],
            outside_limits=status["setpoints_outside_limits"],
            largest_rate=math.radians(status["largest_rate_deg_s"]),
        )

    def _outline(self, true_h: FloatArray) -> tuple[float, float]:
        if self._shape is None:
            return math.nan, math.nan
        theta, h = (np.array(self._shape[name], dtype=np.float64) for name in ("theta_rad", "h_m"))
        score = score_outline(theta, h, np.array(self._shape["touched"], dtype=np.bool_), true_h)
        return score.e_h, score.touched

    def _rms(self) -> tuple[float, float]:
        """Of r1 and r2 together, and of ω0."""
        if not self._errors:
            return math.nan, math.nan
        _, r1, r2, omega0 = np.mean(np.square(self._errors), axis=0).tolist()
        return math.sqrt((r1 + r2) / 2.0), math.sqrt(omega0)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan
