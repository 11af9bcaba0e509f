"""The rig constants that are estimated with the object: names, prior accuracy, and remedies.

Each is the error of a constant with respect to its description; `model.smoothing.R` has their order and equations.
Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from palmd.events import FloatArray
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS

DETERMINED_SHARE = 0.6
"""A constant is determined if the readings reduce its standard deviation below this share of the prior's."""
AMBIGUOUS_SIGMAS = 2.5  # standard deviations from zero, up to which another constant may be the cause
CERTAIN_SIGMAS = (
    4.0  # standard deviations from zero, beyond which an error is reported; high because many are tested repeatedly
)


@dataclass(frozen=True, slots=True)
class RigConstant:
    """One constant: its published name and unit, and its description in messages.

    A message reads "`subject` seems VALUE ± SD `shown` `error_text`: `remedy`"; `factor` converts to the shown
    unit. With `negative_error_text`, VALUE has no sign and that text replaces `error_text` for negative values.
    """

    name: str
    unit: str
    meaning: str
    subject: str
    shown: str
    factor: float
    error_text: str
    remedy: str
    negative_error_text: str = ""


def _of_each_pad(row: RigConstant) -> Iterator[RigConstant]:
    for palm in PALMS:
        yield replace(row, **{name: getattr(row, name).format(palm) for name in ("name", "meaning", "subject")})


RIG_TABLE: tuple[RigConstant, ...] = (
    *_of_each_pad(RigConstant("pad{}_zero_m", "m", "what pad {} reads at the hinge",
                              "pad {}'s zero", " mm", 1e3, "off", "palmd calibrate self finds its zero_mm")),
    *_of_each_pad(RigConstant("pad{}_scale", "", "relative error of pad {}'s scale, > 0 if it reads too much",
                              "pad {}'s scale", " %", 1e2, "off", "palmd calibrate pads measures its counts_per_mm")),
    *_of_each_pad(RigConstant("pad{}_sagitta_m", "m", "height of pad {}'s middle over its ends",
                              "pad {}'s middle", " mm", 1e3, "higher than its ends", "check that it lies flat",
                              "lower than its ends")),
    *_of_each_pad(RigConstant("pad{}_lag_s", "s", "age of pad {}'s readings beyond their time stamps",
                              "pad {}'s time", " ms", 1e3, "late", "check its adapter's latency timer", "early")),
    *_of_each_pad(RigConstant("pad{}_standoff_m", "m", "height of pad {}'s surface over the hinge line",
                              "pad {}'s surface", " mm", 1e3, "above the hinge line", "check how it is mounted",
                              "below the hinge line")),
    RigConstant("phi1_rad", "rad", "error of palm 1's angle against gravity, > 0 if steeper than reported",
                "palm 1's angle to gravity", "°", math.degrees(1), "off", "palmd calibrate self finds the arm's yaw"),
    RigConstant("phi2_rad", "rad", "error of the palms' opening, > 0 if larger than reported",
                "the palms' opening", "°", math.degrees(1), "off",
                "palmd calibrate arm, and check that the pads lie along the palms"),
    RigConstant("friction_asymmetry", "", "(μ1 − μ2)/(μ1 + μ2) of the palms' friction",
                "palm 1's friction", " %", 1e2, "above the mean of both palms'", "clean both if they should be alike",
                "below the mean of both palms'"),
    *_of_each_pad(RigConstant("pad{}_force_m_per_n", "m/N", "shift of pad {}'s readings per contact force",
                              "pad {}'s reading", " mm/N", 1e3, "off with the contact's force",
                              "check that nothing yields under it")),
    RigConstant("vibration_kappa", "", "error of κ, the mean product of both palms' slip signs",
                "the relation κ of the palms' vibrations", "", 1.0, "off", "set rig.vibration.relation"),
    RigConstant("vibration_transmission", "", "error of λ, the share of friction's alternation in the normal forces",
                "the transmission λ of the vibration", "", 1.0, "off", "set rig.vibration.transmission"),
    RigConstant("vibration_period", "", "relative error of the vibration's period, > 0 if longer than described",
                "the period of the palms' vibration", " %", 1e2, "off", "set rig.vibration.frequency_hz"),
    RigConstant("friction_arm", "", "relative error of friction's lever arm, > 0 if longer than the radius",
                "friction's arm", " %", 1e2, "off", "check that the palms vibrate along themselves"),
)  # fmt: skip
RIG_NAMES = tuple(constant.name for constant in RIG_TABLE)


def prior_sds(rig: RigDescription) -> FloatArray:
    """Prior standard deviation of each constant, in the order of `RIG_TABLE`."""
    of_pads = [[pad.zero_sd, pad.scale_sd, pad.sagitta_sd, pad.lag_sd, pad.standoff_sd] for pad in rig.pads]
    of_angles = math.hypot(rig.angle_sd, rig.gravity_sd), rig.angle_sd
    vibration = rig.vibration
    of_vibration = vibration.kappa_sd, vibration.nominal_transmission_sd, vibration.period_sd, vibration.arm_sd
    return np.array(
        [
            *np.transpose(of_pads).ravel(),
            *of_angles,
            rig.friction_sd,
            *(pad.force_sd for pad in rig.pads),
            *of_vibration,
        ]
    )


def declared_exact(rig: RigDescription) -> bool:
    """Whether every constant that calibration measures is declared exact (all but the asymmetry of friction)."""
    return not prior_sds(rig)[: RIG_NAMES.index("friction_asymmetry")].any()


def determined(sds: FloatArray, priors: FloatArray) -> npt.NDArray[np.bool_]:
    """Which constants the readings determine, by their posterior and prior standard deviations."""
    return sds < DETERMINED_SHARE * priors


def describe_rig_errors(values: FloatArray, sds: FloatArray, priors: FloatArray, contradicted: FloatArray) -> list[str]:
    """The errors beyond doubt, in words with remedies; only of constants that the readings determine.

    values, sds, priors: error of each constant, its posterior and prior standard deviation; SI, as `RIG_TABLE`.
    contradicted: not 0 where the readings contradict the description, whether because of this constant or another one
    with a nonzero value.
    """
    sure = determined(sds, priors) & (np.abs(values) > CERTAIN_SIGMAS * sds)
    texts = []
    for i in np.flatnonzero(sure | (contradicted != 0.0)):
        constant, value = RIG_TABLE[i], shown(RIG_TABLE[i], float(values[i]), float(sds[i]))
        seems = "seems" if abs(values[i]) > AMBIGUOUS_SIGMAS * sds[i] else "may be the cause, and seems"
        error_text, value = constant.error_text, value if not constant.negative_error_text else value.lstrip("+-")
        error_text = constant.negative_error_text if constant.negative_error_text and values[i] < 0.0 else error_text
        texts.append(f"{constant.subject} {seems} {value} {error_text}: {constant.remedy}")
    return texts


def shown(constant: RigConstant, value: float, sd: float) -> str:
    """A constant's value with its standard deviation (SI) in the unit shown, with the digits that are significant."""
    value, sd = constant.factor * value, constant.factor * sd
    digits = max(-math.floor(math.log10(sd)), 0)  # one significant digit of the standard deviation
    return f"{value:+z.{digits}f} ± {sd:.{digits}f}{constant.shown}"
