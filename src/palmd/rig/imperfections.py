"""The emulated rig's deviations from its configuration: true errors of its constants, configured or drawn. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from operator import add
from typing import TypeVar

import numpy as np

from palmd.config.any_config import AnyConfig
from palmd.config.fields import Strict
from palmd.config.two_palms import Config, PadImperfectionsConfig, rig_description
from palmd.events import Joints, PalmMotion
from palmd.system.description import CALIBRATION_KEYS, RigDescription
from palmd.system.mechanism import JOINTS, PALMS

Section = TypeVar("Section", bound=Strict)
Described = TypeVar("Described", bound=AnyConfig)

_MAX_SIGMAS = 3.0  # a drawn error never exceeds this many standard deviations
_MAX_ASYMMETRY = 0.9  # of drawn friction, so that both palms have friction
_STEPS_PER_LENGTH = 12  # of a smooth error's grid, per correlation length: interpolation then errs by 1/1000 of it
_SEED_STREAM = 17  # own random stream: a seed's object does not depend on the imperfections


@dataclass(frozen=True, slots=True)
class SmoothError:
    """A pad's position error (m) at evenly spaced places from the hinge to its end; zero everywhere if empty."""

    values: tuple[float, ...] = ()
    length: float = 0.0

    def at(self, s: float) -> float:
        """The error (m) at distance `s` (m) from the hinge; constant beyond the pad's ends."""
        if not self.values:
            return 0.0
        step = self.length / (len(self.values) - 1)
        return float(np.interp(s / step, np.arange(len(self.values)), self.values))


NO_ERROR = SmoothError()


@dataclass(frozen=True, slots=True)
class PadImperfection:
    """One pad's errors with respect to its description; SI units, signs as of the smoother's constants.

    For a contact at s under a force f (N) it reads zero + force·f + (1 + scale)·s + smooth_error(s), delayed by `lag`.
    Its surface lies `standoff` above the hinge line, on the object's side, and is a parabola that is `sagitta` higher
    in the pad's middle than at its ends.
    """

    zero: float = 0.0
    scale: float = 0.0
    sagitta: float = 0.0
    lag: float = 0.0
    standoff: float = 0.0
    force: float = 0.0
    smooth_error: SmoothError = NO_ERROR

    def reading_error_m(self, s: float, force: float) -> float:
        """Error (m) of a reading of a contact at distance `s` (m) from the hinge under a force (N); without the lag."""
        return self.zero + self.scale * s + self.force * force + self.smooth_error.at(s)

    def tangent_plane(self, s: float, length: float) -> tuple[float, float]:
        """Slope (rad) and height over the hinge (m) of the surface's tangent at s (m), on a pad of this length (m)."""
        u = s / length
        return 4.0 * self.sagitta / length * (1.0 - 2.0 * u), self.standoff + 4.0 * self.sagitta * u * u


_CONSTANTS = tuple(each.name for each in fields(PadImperfection) if each.name != "smooth_error")


@dataclass(frozen=True, slots=True)
class Imperfections:
    """True errors of all rig constants that the smoother estimates, and table vibration; by default none.

    True φ1 and φ2 exceed the nominal ones by `angles` (rad); if the table tips, φ1 above the horizontal does so by
    another `gravity` (rad). Contacts cannot distinguish the two. friction: (μ1 − μ2)/(μ1 + μ2). The table shakes
    vertically with an acceleration of `vibration` (m/s², RMS).
    """

    pads: tuple[PadImperfection, ...] = tuple(PadImperfection() for _ in PALMS)
    angles: Joints = (0.0,) * len(JOINTS)
    gravity: float = 0.0
    friction: float = 0.0
    vibration: float = 0.0

    def true_palms(self, nominal: PalmMotion) -> PalmMotion:
        """The palms' true motion, from the nominal one."""
        if not (self.gravity or any(self.angles)):
            return nominal
        return PalmMotion(tuple(map(add, nominal.angles, self._angle_errors)), nominal.rates, nominal.accelerations)

    @property
    def _angle_errors(self) -> Joints:
        """Error of each joint angle against gravity; the first palm's includes the table's tilt."""
        return self.angles[0] + self.gravity, *self.angles[1:]

    def constants(self) -> dict[str, float]:
        """All errors by the names of the rig's constants in results."""
        of_pads = {CALIBRATION_KEYS[f"{name}_sd"]: name for name in _CONSTANTS}
        return {
            f"pad{palm}_{key}": getattr(pad, name)
            for key, name in of_pads.items()
            for palm, pad in zip(PALMS, self.pads, strict=True)
        } | {
            **{f"{joint}_rad": error for joint, error in zip(JOINTS, self._angle_errors, strict=True)},
            "friction_asymmetry": self.friction,
            "vibration_kappa": 0.0,  # relative to the rig's description
            "vibration_transmission": 0.0,
            "vibration_period": 0.0,
            "friction_arm": 0.0,
        }


PERFECT = Imperfections()
"""A rig exactly as described."""


def drawn(rig: RigDescription, *seed: int) -> Imperfections:
    """Draw a rig from the standard deviations (`_sd`) of `rig`: normal errors, truncated at three of them.

    Pads have smooth position errors of the described size and correlation length.
    """
    random = np.random.default_rng([*seed, _SEED_STREAM])

    def error(sd: float) -> float:
        return sd * float(np.clip(random.standard_normal(), -_MAX_SIGMAS, _MAX_SIGMAS))

    constants = [{name: error(getattr(pad, f"{name}_sd")) for name in _CONSTANTS} for pad in rig.pads]
    smooth_errors = [
        drawn_error(pad.map_sd, pad.map_length, pad.length, np.random.default_rng([*seed, _SEED_STREAM, number]))
        for number, pad in enumerate(rig.pads)
    ]
    return Imperfections(
        tuple(
            PadImperfection(**own, smooth_error=smooth_error)
            for own, smooth_error in zip(constants, smooth_errors, strict=True)
        ),
        (error(rig.angle_sd), error(rig.angle_sd)),
        error(rig.gravity_sd),
        min(max(error(rig.friction_sd), -_MAX_ASYMMETRY), _MAX_ASYMMETRY),
    )


def drawn_error(sd: float, correlation: float, length: float, rng: np.random.Generator) -> SmoothError:
    """Draw a Gaussian process with standard deviation `sd` and squared-exponential `correlation` length on a pad (m).

    Its constant and linear parts are removed: these are the pad's zero and scale.
    """
    if sd == 0.0:
        return NO_ERROR
    s = np.linspace(0.0, length, 1 + max(2, int(np.ceil(_STEPS_PER_LENGTH * length / correlation))))
    covariance = np.exp(-0.5 * np.subtract.outer(s, s) ** 2 / correlation**2)
    eigenvalues, eigenvectors = np.linalg.eigh(covariance)
    drawn = sd * eigenvectors @ (np.sqrt(np.maximum(eigenvalues, 0.0)) * rng.standard_normal(len(s)))
    trend, _ = np.linalg.qr(np.stack([np.ones_like(s), s], axis=1))
    return SmoothError(tuple((drawn - trend @ (trend.T @ drawn)).tolist()), length)


def configured(config: Config, seed: int) -> Imperfections:
    """Imperfections as `rig.imperfections` states; `calibrated` is drawn by `seed` from the configuration's `_sd`s."""
    settings = config.rig.imperfections
    if settings == "none":
        return PERFECT
    if settings == "calibrated":  # the emulated actuator has its own backlash
        rig = replace(rig_description(config), angle_sd=math.radians(config.rig.angle_sd_deg))
        return drawn(rig, seed)
    return Imperfections(
        tuple(_pad(getattr(settings, f"palm{palm}")) for palm in PALMS),
        tuple(math.radians(getattr(settings, f"{joint}_deg")) for joint in JOINTS),
        math.radians(settings.gravity_deg),
        settings.friction_asymmetry,
        settings.vibration_m_s2,
    )


def perfect(config: Described) -> Described:
    """The configuration of a rig exactly as described, and known to be."""
    pads = {f"palm{palm}": _known(pad) for palm, pad in enumerate(config.pads.each(), 1)}
    rig = _known(config.rig).model_copy(update={"imperfections": "none"})
    return config.model_copy(update={"rig": rig, "pads": config.pads.model_copy(update=pads)})


def _known(section: Section) -> Section:
    """The section with every `_sd` set to zero."""
    return section.model_copy(update={name: 0.0 for name in type(section).model_fields if "_sd" in name})


def _pad(settings: PadImperfectionsConfig) -> PadImperfection:
    return PadImperfection(
        zero=settings.zero_mm * 1e-3,
        scale=settings.scale,
        sagitta=settings.sagitta_mm * 1e-3,
        lag=settings.lag_ms * 1e-3,
        standoff=settings.standoff_mm * 1e-3,
        force=settings.force_mm_per_n * 1e-3,
    )
