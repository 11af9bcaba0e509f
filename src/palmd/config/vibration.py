"""Configuration of the palms' vibration: the block `rig.vibration`."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, FiniteFloat, model_validator

from palmd.config.fields import NotNegative, Plausible, Positive, Strict
from palmd.system.vibration import VIBRATION_KEYS, VIBRATION_SD_KEYS, Relation, Vibration, VibrationLaw

MOST_HZ = 5000.0  # upper limit of a shaker's frequency (convention: small ones have 200 to 280 Hz)


class VibrationConfig(Strict):
    """Vibration of the palms along themselves; omitted values are unknown, and estimated where observable."""

    relation: Relation = "independent"
    """Phase of the palms: `in_phase` moves both away from the hinge at once; `none`: no shaker, dry friction."""
    frequency_hz: Annotated[Positive, Field(le=MOST_HZ), Plausible(50, 1000)] | None = None
    """Frequency of both palms; independently vibrating palms differ by 5 Hz or more."""
    frequency_sd_hz: NotNegative | None = None
    """Standard deviation of the frequency."""
    speed_m_s: Annotated[Positive, Field(le=1), Plausible(0.002, 0.1)] | None = None
    """Amplitude of a palm's speed along itself: 2π · frequency · amplitude."""
    speed_sd_m_s: NotNegative | None = None
    """Standard deviation of the speed; default 10 % of it."""
    transmission: Annotated[FiniteFloat, Field(ge=0, le=1)] | None = None
    """Ripple transmission: share of the alternating friction that the normal forces follow; 1 on a stiff heavy palm."""
    transmission_sd: NotNegative | None = None
    """Standard deviation of the transmission; default 0.10."""
    law: VibrationLaw = "sign_pairs"
    """Friction law; `averaged` is that of old logs and not for real rigs."""

    @model_validator(mode="before")
    @classmethod
    def _sd_at_the_end(cls, value: Any) -> Any:
        """Accept `speed_m_s_sd` for `speed_sd_m_s`."""
        if not isinstance(value, dict):
            return value
        named = {f"{key}_sd": VIBRATION_SD_KEYS[f"{name}_sd"] for name, key in VIBRATION_KEYS.items()}
        return {named.get(key, key): each for key, each in value.items()}


def vibration_of(config: VibrationConfig) -> Vibration:
    """Convert the configuration to the observers' description."""
    keys = VIBRATION_KEYS | VIBRATION_SD_KEYS
    values: dict[str, Any] = {name: getattr(config, key) for name, key in keys.items()}
    return Vibration(relation=config.relation, law=config.law, **values)
