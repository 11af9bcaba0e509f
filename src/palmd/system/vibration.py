"""How the palms vibrate along themselves, and which law of friction that asks for. SI units. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Relation = Literal["independent", "in_phase", "antiphase", "unknown", "none"]
"""Between the palms: `in_phase` moves both away from the hinge at the same time; `none`: palms do not vibrate."""
VibrationLaw = Literal["sign_pairs", "averaged"]
"""`sign_pairs`: the contact equations averaged over the signs of slip; `averaged`: friction alone, old logs' law."""

SPEED_M_S, LN_SPEED_SD = 0.014, 0.35
"""A shaker's speed V where it is not given, and one sigma of its logarithm."""
AVERAGED_SPEED_M_S = 0.012 / (math.pi / 2)
SHAKER_SD, LEAST_LN_SD = 0.10, 1e-3
"""One sigma of ln V of a shaker whose speed is given without one; and the least that there is."""
FREQUENCY_HZ = 240.0
"""A shaker's, where it is not given: amidst the 200 to 280 Hz of small shakers."""
UNKNOWN_PERIOD_SD = 0.5
"""One sigma of the period of a shaker of unknown frequency, as a share of it (assumption: 160 to 480 Hz)."""
RIPPLE_SD = 0.25
"""One sigma of the ripple's effect on the motion, as a share of it, where the frequency is known exactly (study of
resolved vibrations, 2026-11-29: the law leaves 14 to 58 % of the effect)."""
ARM_SD = 0.02
"""One sigma of the share by which friction's arm about the centre of mass differs from the radius: the law's own error
(study of seven logs of Chipmunk and Drake, 2026-11-30: 0.01 beyond its own band; a vibration across the palm of 1 % of
its speed would add 0.02)."""
UNKNOWN_KAPPA_SD = 0.7
TRANSMISSION_SD = 0.10
"""One sigma of λ where none is given: mounts and contacts give a little."""
_KAPPA: Mapping[Relation, float] = {
    "independent": 0.0, "in_phase": -1.0, "antiphase": 1.0, "unknown": 0.0, "none": 0.0
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Vibration:
    """What is known of the palms' vibration; by default independent, and of it nothing else. None: unknown.

    frequency in Hz. speed: amplitude of a palm's speed along itself, V (m/s). transmission: λ, the share of the
    friction's alternation that the normal forces follow (0 to 1). Each `_sd` is one sigma of the value beside it.
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
        """Whether the palms vibrate at all; where they do not, friction is dry Coulomb friction."""
        return self.relation != "none"

    @property
    def averaged(self) -> bool:
        """Whether friction is that of the averaged law; of dry palms it stands for sticking, smoothly."""
        return self.law == "averaged" or not self.vibrates

    @property
    def kappa(self) -> float:
        """κ, the mean product of both slips' signs at rest; 0 where it is not known."""
        return _KAPPA[self.relation]

    @property
    def kappa_sd(self) -> float:
        """One sigma of κ."""
        return UNKNOWN_KAPPA_SD if self.relation == "unknown" and not self.averaged else 0.0

    @property
    def half_period(self) -> float:
        """1/(2f) (s); 0 where the body's ripple plays no part, as with the averaged law."""
        return 0.0 if self.averaged else 0.5 / (self.frequency or FREQUENCY_HZ)

    @property
    def period_sd(self) -> float:
        """One sigma of the period, as a share of it, what the law does not know of the ripple included."""
        if self.averaged:
            return 0.0
        known = UNKNOWN_PERIOD_SD if self.frequency is None else (self.frequency_sd or 0.0) / self.frequency
        return math.hypot(known, RIPPLE_SD)

    @property
    def arm_sd(self) -> float:
        """One sigma of friction's arm about the object's middle, as a share of it: what the law leaves open."""
        return 0.0 if self.averaged else ARM_SD

    @property
    def likeliest_transmission(self) -> float:
        """λ; 1, rigid palms and a rigid body, where it is not given."""
        return 1.0 if self.transmission is None else self.transmission

    @property
    def likeliest_transmission_sd(self) -> float:
        """One sigma of λ."""
        if self.averaged:
            return 0.0
        return TRANSMISSION_SD if self.transmission_sd is None else self.transmission_sd

    @property
    def ln_speed(self) -> tuple[float, float]:
        """ln V (m/s) and its one sigma."""
        if self.speed is None:
            return math.log(AVERAGED_SPEED_M_S if self.averaged else SPEED_M_S), LN_SPEED_SD
        return math.log(self.speed), SHAKER_SD if self.speed_sd is None else max(
            self.speed_sd / self.speed, LEAST_LN_SD
        )


INDEPENDENT = Vibration()
"""What palms are taken for of which nothing is known."""
DRY = Vibration(relation="none")
"""Palms that stand still unless the motion plan moves them."""
AVERAGED = Vibration(law="averaged")
"""Palms whose friction follows the averaged law, as simulated before the law of sign pairs was known."""

VIBRATION_KEYS = {"frequency": "frequency_hz", "speed": "speed_m_s", "transmission": "transmission"}
VIBRATION_SD_KEYS = {
    "frequency_sd": "frequency_sd_hz",
    "speed_sd": "speed_sd_m_s",
    "transmission_sd": "transmission_sd",
}
"""How logs and configurations call the fields of `Vibration`."""


def vibration_line(vibration: Vibration) -> dict[str, Any]:
    """The block `vibration` of a log's rig; what is not known is left out."""
    known = {key: getattr(vibration, name) for name, key in (VIBRATION_KEYS | VIBRATION_SD_KEYS).items()}
    law = {"law": vibration.law} if vibration.law != "sign_pairs" else {}
    return {"relation": vibration.relation, **{key: value for key, value in known.items() if value is not None}, **law}
