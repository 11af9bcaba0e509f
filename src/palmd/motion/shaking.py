"""Notes on vibration and dither of configurations and plans: whether they average friction, and which law holds."""

from __future__ import annotations

import math
from collections.abc import Iterator

from palmd.config.any_config import AnyConfig
from palmd.config.two_palms import Config, DitherSpec, PlanSpec
from palmd.config.vibration import VibrationConfig
from palmd.system.excitation import (
    FASTER,
    MOST_FRICTION,
    PLAN_MOST_HZ,
    RESONANT,
    SLOW_HZ,
    Excitation,
    Regime,
    friction_acceleration,
    least_speed,
    regime,
    resonance_hz,
    resonates,
    swung,
)

LIGHT_KG, HEAVY_KG = 0.03, 0.2
"""Range of masses of usual objects."""


def shaking_of(config: AnyConfig) -> Iterator[str]:
    """Yield notes on the vibration in a configuration."""
    vibration: VibrationConfig = config.rig.vibration
    if vibration.relation == "none":
        yield "rig.vibration: none: friction is dry, and objects stick and slip"
        return
    frequency, speed = vibration.frequency_hz, vibration.speed_m_s
    if frequency is None:
        return
    if frequency < FASTER * SLOW_HZ:
        yield (
            f"rig.vibration: {frequency:g} Hz is neither motion (up to {PLAN_MOST_HZ:g} Hz) nor fast enough to average"
            f" friction: vibrate at {FASTER * SLOW_HZ:g} Hz or faster"
        )
    elif speed is not None:
        yield _strength(Excitation(frequency, speed), config.rig.gravity_m_s2)
    stiffness = _stiffness(config)
    if stiffness is not None:
        low, high = (resonance_hz(stiffness, mass) for mass in (HEAVY_KG, LIGHT_KG))
        if resonates(frequency, low) or resonates(frequency, high) or low < frequency < high:
            yield (
                f"rig.vibration: {frequency:g} Hz is near the resonance of objects on a pad ({low:.0f} to {high:.0f} Hz"
                f" for {HEAVY_KG * 1e3:g} to {LIGHT_KG * 1e3:g} g): forces do not follow the law. Avoid frequencies of"
                f" {RESONANT[0]:g} to {RESONANT[1]:g} times the resonance"
            )


def _strength(vibration: Excitation, gravity: float) -> str:
    friction = friction_acceleration(MOST_FRICTION, gravity)
    text = f"rig.vibration: {vibration.frequency:g} Hz, {vibration.speed * 1e3:g} mm/s"
    if regime(vibration, friction) is Regime.AVERAGED:
        return f"{text}: averaged; no contact sticks up to a coefficient of friction of {MOST_FRICTION:g}"
    most = MOST_FRICTION * vibration.speed / least_speed(vibration.frequency, friction)
    return (
        f"{text} is weak: contacts stick from a coefficient of friction of {most:.2g} on, and no law holds."
        f" For {MOST_FRICTION:g} it takes {least_speed(vibration.frequency, friction) * 1e3:.0f} mm/s"
    )


def _stiffness(config: AnyConfig) -> float | None:
    """Return the stiffness of the softest pad (N/m), None if unknown."""
    known = [getattr(pad, "stiffness_n_per_mm", None) for pad in config.pads.each()]
    stiff = [1e3 * each for each in known if each is not None]
    return min(stiff) if stiff else None


def shaking_by(plan: PlanSpec, config: Config) -> Iterator[str]:
    """Yield notes on a plan's dither, on the rig of a configuration."""
    if plan.dither is None:
        return
    shaken = swung_by(plan.dither, reach_m(config))
    most = shaken.acceleration / friction_acceleration(1.0, config.rig.gravity_m_s2)
    yield (
        f"dither: {plan.dither.amplitude_deg:g}° at {plan.dither.frequency_hz:g} Hz is motion,"
        f" {shaken.speed * 1e3:.1f} mm/s at a contact: it breaks no friction above a coefficient of {most:.2g}"
    )
    if config.rig.vibration.relation != "none":
        yield (
            f"dither: the configuration says that the palms vibrate too ({config.rig.vibration.relation}): if there is"
            " no shaker, friction is dry: set rig.vibration.relation to none"
        )


def swung_by(dither: DitherSpec, reach: float) -> Excitation:
    """Return the motion that a plan's dither causes at a contact at this distance from the hinge (m)."""
    return swung(math.radians(dither.amplitude_deg), dither.frequency_hz, reach)


def reach_m(config: Config) -> float:
    """Return a typical distance of contacts from the hinge: the middle of the longest pad (m)."""
    return 0.5e-3 * max(pad.length_mm for pad in config.pads.each())
