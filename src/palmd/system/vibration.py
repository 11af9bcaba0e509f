"""How the palms vibrate along themselves, and which law of friction that asks for (THEORY_DITHER). SI units. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Relation = Literal["independent", "in_phase", "antiphase", "unknown", "none"]
"""Between the palms: `in_phase` moves both away from the hinge at the same time; `none`: palms do not vibrate."""
VibrationLaw = Literal["sign_pairs", "averaged"]
"""`sign_pairs`: the contact equations averaged over the signs of slip; `averaged`: friction alone, old logs' law."""


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
