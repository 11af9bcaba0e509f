"""Vibration of the palms along themselves, and the friction law that follows. SI units. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Relation = Literal["independent", "in_phase", "antiphase", "unknown", "none"]
"""Phase relation of the palms; `in_phase`: both move away from the hinge at once; `none`: they do not vibrate."""
VibrationLaw = Literal["sign_pairs", "averaged"]
"""`sign_pairs`: contact equations averaged over slip signs; `averaged`: only friction averaged (old logs)."""

SPEED_M_S, LN_SPEED_SD = 0.0115, 0.45
"""Default speed V of a shaker, and standard deviation of its logarithm (assumption: 5 to 25 mm/s)."""
AVERAGED_SPEED_M_S = 0.012 / (math.pi / 2)
SHAKER_SD, LEAST_LN_SD = 0.10, 1e-3
"""Standard deviation of ln V if the speed is given without one, and its smallest value."""
FREQUENCY_HZ = 300.0
"""Default frequency of a shaker; small ones have 200 to 280 Hz, and the effect of the ripple ends at high ones."""
UNKNOWN_PERIOD_SD = 0.7
"""Relative standard deviation of the period of a shaker of unknown frequency (assumption: from 160 Hz
to so fast that there is no ripple)."""
RIPPLE_SD = 0.25
"""Relative standard deviation of the ripple's effect on the motion if the frequency is known exactly (study of resolved
vibrations, 2026-11-29: the law leaves 14 to 58 % of the effect)."""
ARM_SD = 0.02
"""Relative standard deviation of friction's lever arm about the centre of mass with respect to the radius: the law's
own error (study of seven logs of Chipmunk and Drake, 2026-11-30: 0.01 beyond its own band; a vibration across the palm
of 1 % of its speed would add 0.02)."""
UNKNOWN_KAPPA_SD = 0.7
TRANSMISSION_SD = 0.10
"""Standard deviation of λ if none is given: mounts and contacts are slightly elastic."""
_KAPPA: Mapping[Relation, float] = {
    "independent": 0.0, "in_phase": -1.0, "antiphase": 1.0, "unknown": 0.0, "none": 0.0
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Vibration:
    """What is known of the palms' vibration; by default independent and otherwise unknown. None: unknown.

    frequency in Hz. speed: amplitude of a palm's speed along itself, V (m/s). transmission: λ, the share of the
    friction's alternation that the normal forces follow (0 to 1). Each `_sd` is the standard deviation of the value
    beside it.
    """

    relation: Relation = "independent"
    frequency: float | None = None
    frequency_sd: float | None = None
    speed: float | None = None
    speed_sd: float | None = None
    transmission: float | None = None
    transmission_sd: float | None = None
    law: VibrationLaw = "sign_pairs"

    @property
    def vibrates(self) -> bool:
        """Whether the palms vibrate; if not, friction is dry Coulomb friction."""
        return self.relation != "none"

    @property
    def averaged(self) -> bool:
        """Whether friction follows the averaged law; for dry palms it is a smooth approximation of sticking."""
        return self.law == "averaged" or not self.vibrates

    @property
    def kappa(self) -> float:
        """κ, the mean product of both slips' signs at rest; 0 if unknown."""
        return _KAPPA[self.relation]

    @property
    def kappa_sd(self) -> float:
        """Standard deviation of κ."""
        return UNKNOWN_KAPPA_SD if self.relation == "unknown" and not self.averaged else 0.0

    @property
    def half_period(self) -> float:
        """1/(2f) (s); 0 where the body's ripple has no effect, as with the averaged law."""
        return 0.0 if self.averaged else 0.5 / (self.frequency or FREQUENCY_HZ)

    @property
    def period_sd(self) -> float:
        """Relative standard deviation of the period, including the law's uncertainty about the ripple."""
        if self.averaged:
            return 0.0
        known = UNKNOWN_PERIOD_SD if self.frequency is None else (self.frequency_sd or 0.0) / self.frequency
        return math.hypot(known, RIPPLE_SD)

    @property
    def arm_sd(self) -> float:
        """Relative standard deviation of friction's lever arm about the centre of mass, due to the law."""
        return 0.0 if self.averaged else ARM_SD

    @property
    def nominal_transmission(self) -> float:
        """λ; 1 (rigid palms and body) if it is not given."""
        return 1.0 if self.transmission is None else self.transmission

    @property
    def nominal_transmission_sd(self) -> float:
        """Standard deviation of λ."""
        if self.averaged:
            return 0.0
        return TRANSMISSION_SD if self.transmission_sd is None else self.transmission_sd

    @property
    def ln_speed(self) -> tuple[float, float]:
        """ln V (m/s) and its standard deviation."""
        if self.speed is None:
            return math.log(AVERAGED_SPEED_M_S if self.averaged else SPEED_M_S), LN_SPEED_SD
        return math.log(self.speed), SHAKER_SD if self.speed_sd is None else max(
            self.speed_sd / self.speed, LEAST_LN_SD
        )


INDEPENDENT = Vibration()
"""Assumption about palms of which nothing is known."""
DRY = Vibration(relation="none")
"""Palms that move only by the motion plan."""
AVERAGED = Vibration(law="averaged")
"""Palms whose friction follows the averaged law, as simulated before the law of sign pairs was known."""

VIBRATION_KEYS = {"frequency": "frequency_hz", "speed": "speed_m_s", "transmission": "transmission"}
VIBRATION_SD_KEYS = {
    "frequency_sd": "frequency_sd_hz",
    "speed_sd": "speed_sd_m_s",
    "transmission_sd": "transmission_sd",
}
"""Names in logs and configurations of the fields of `Vibration`."""


def vibration_line(vibration: Vibration) -> dict[str, Any]:
    """The block `vibration` of a log's rig; unknown values are left out."""
    known = {key: getattr(vibration, name) for name, key in (VIBRATION_KEYS | VIBRATION_SD_KEYS).items()}
    law = {"law": vibration.law} if vibration.law != "sign_pairs" else {}
    return {"relation": vibration.relation, **{key: value for key, value in known.items() if value is not None}, **law}
