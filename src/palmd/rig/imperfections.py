"""Where the emulated rig is not what its configuration says: the true errors of its constants, set or drawn. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from operator import add
from typing import Any, TypeVar

import numpy as np

from palmd.config.any_config import AnyConfig
from palmd.config.fields import Strict
from palmd.config.two_palms import Config, PadImperfectionsConfig, rig_description
from palmd.events import Joints, PalmMotion
from palmd.rig.smooth_error import NO_ERROR, SmoothError, drawn_error
from palmd.system.description import CALIBRATION_KEYS, RigDescription
from palmd.system.mechanism import JOINTS, PALMS

Section = TypeVar("Section", bound=Strict)
Described = TypeVar("Described", bound=AnyConfig)

_MOST_SIGMAS = 3.0  # what calibration leaves is never further off than this
_MOST_ASYMMETRY = 0.9  # of a drawn friction: both palms rub
_STREAM = 17  # of a seed's random numbers, so that the same seed has the same object with and without imperfections


@dataclass(frozen=True, slots=True)
class PadImperfection:
    """By how much one palm's pad is off from what it is taken for; SI units, signs as of the smoother's constants.

    It reads zero + force·f + (1 + scale)·s + place(s) of a contact at s under a force f (N), as it was `lag` ago. Its
    surface lies
    `standoff` above the hinge line, on the object's side, and is a parabola that is `sagitta` higher in the pad's
    middle than at its ends.
    """

    zero: float = 0.0
    scale: float = 0.0
    sagitta: float = 0.0
    lag: float = 0.0
    standoff: float = 0.0
    force: float = 0.0
    place: SmoothError = NO_ERROR

    def reading_error_m(self, s: float, force: float) -> float:
        """A reading less the contact's true distance `s` (m) from the hinge, under a force (N); without the lag."""
        return self.zero + self.scale * s + self.force * force + self.place.at(s)

    def tangent_plane(self, s: float, length: float) -> tuple[float, float]:
        """What touches the surface, of that length (m), at s (m): its slope (rad) and its height over the hinge (m)."""
        u = s / length
        return 4.0 * self.sagitta / length * (1.0 - 2.0 * u), self.standoff + 4.0 * self.sagitta * u * u


_CONSTANTS = tuple(each.name for each in fields(PadImperfection) if each.name != "place")


@dataclass(frozen=True, slots=True)
class Imperfections:
    """The true errors of every constant of the rig that the smoother estimates, and vibration; by default none.

    True φ1 and φ2 exceed those that are told by `angles` (rad), and where the table tips, φ1 above the horizontal by
    `gravity` (rad) more; the two are one to whoever feels. friction: (μ1 − μ2)/(μ1 + μ2). The table shakes up and down
    with an acceleration of `vibration` (m/s², RMS).
    """

    pads: tuple[PadImperfection, ...] = tuple(PadImperfection() for _ in PALMS)
    angles: Joints = (0.0,) * len(JOINTS)
    gravity: float = 0.0
    friction: float = 0.0
    vibration: float = 0.0

    def true_palms(self, told: PalmMotion) -> PalmMotion:
        """Where the palms really are, from what is told of them."""
        if not (self.gravity or any(self.angles)):
            return told
        return PalmMotion(tuple(map(add, told.angles, self._off)), told.rates, told.accelerations)

    @property
    def _off(self) -> Joints:
        """By how much each joint angle is off against gravity: the first palm's tips with the table."""
        return self.angles[0] + self.gravity, *self.angles[1:]

    def constants(self) -> dict[str, float]:
        """By the names that results give the rig's constants."""
        of_pads = {CALIBRATION_KEYS[f"{name}_sd"]: name for name in _CONSTANTS}
        return {
            f"pad{palm}_{told}": getattr(pad, name)
            for told, name in of_pads.items()
            for palm, pad in zip(PALMS, self.pads, strict=True)
        } | {
            **{f"{joint}_rad": off for joint, off in zip(JOINTS, self._off, strict=True)},
            "friction_asymmetry": self.friction,
            "vibration_kappa": 0.0,  # that of the rig's description
            "vibration_transmission": 0.0,
            "vibration_period": 0.0,
            "friction_arm": 0.0,
        }


PERFECT = Imperfections()
"""A rig that is as it is described."""


def drawn(rig: RigDescription, *seed: int) -> Imperfections:
    """A rig as good as `rig` says by its `_sd`: every error normal with that one-sigma, cut at three of them.

    Pads have smooth errors of place as large and as long as it says.
    """
    random = np.random.default_rng([*seed, _STREAM])

    def error(sd: float) -> float:
        return sd * float(np.clip(random.standard_normal(), -_MOST_SIGMAS, _MOST_SIGMAS))

    constants = [{name: error(getattr(pad, f"{name}_sd")) for name in _CONSTANTS} for pad in rig.pads]
    places = [
        drawn_error(pad.map_sd, pad.map_length, pad.length, np.random.default_rng([*seed, _STREAM, number]))
        for number, pad in enumerate(rig.pads)
    ]
    return Imperfections(
        tuple(PadImperfection(**own, place=place) for own, place in zip(constants, places, strict=True)),
        (error(rig.angle_sd), error(rig.angle_sd)),
        error(rig.gravity_sd),
        min(max(error(rig.friction_sd), -_MOST_ASYMMETRY), _MOST_ASYMMETRY),
    )


def configured(config: Config, seed: int) -> Imperfections:
    """What `rig.imperfections` asks for; `calibrated` is drawn by `seed` from the configuration's own `_sd`."""
    asked = config.rig.imperfections
    if asked == "none":
        return PERFECT
    if asked == "calibrated":  # the emulated actuator has its play itself
        rig = replace(rig_description(config), angle_sd=math.radians(config.rig.angle_sd_deg))
        return drawn(rig, seed)
    return Imperfections(
        tuple(_pad(getattr(asked, f"palm{palm}")) for palm in PALMS),
        tuple(math.radians(getattr(asked, f"{joint}_deg")) for joint in JOINTS),
        math.radians(asked.gravity_deg),
        asked.friction_asymmetry,
        asked.vibration_m_s2,
    )


def perfect(config: Described) -> Described:
    """The configuration of a rig that is exactly as described, which is known."""
    pads = {f"palm{palm}": _known(pad) for palm, pad in enumerate(config.pads.each(), 1)}
    rig = _known(config.rig).model_copy(update={"imperfections": "none"})
    return _with(config, {"rig": rig, "pads": config.pads.model_copy(update=pads)})


def _known(section: Section) -> Section:
    """With every `_sd` at zero."""
    return _with(section, {name: 0.0 for name in type(section).model_fields if "_sd" in name})


def _with(section: Section, update: Mapping[str, Any]) -> Section:
    return section.model_copy(update=update)


def _pad(asked: PadImperfectionsConfig) -> PadImperfection:
    return PadImperfection(
        zero=asked.zero_mm * 1e-3,
        scale=asked.scale,
        sagitta=asked.sagitta_mm * 1e-3,
        lag=asked.lag_ms * 1e-3,
        standoff=asked.standoff_mm * 1e-3,
        force=asked.force_mm_per_n * 1e-3,
    )
