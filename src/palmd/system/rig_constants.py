"""The rig's constants that are estimated with the object: their names, how well they are known, and what to do.

Each is by how much something is off from what it is taken for; `model.smoothing.R` has their order and equations. Pure.
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

TOLD = 0.6
"""Readings have told a constant when they leave less than this share of its one-sigma beforehand."""
OTHERS = 2.5  # one-sigmas from zero, up to which it may be another constant that is off in its place
SURE = 4.0  # one-sigmas from zero, beyond which one is called off; it is asked of many, again and again


@dataclass(frozen=True, slots=True)
class RigConstant:
    """One constant: its published name and unit, and how people are told of it.

    They read "`what` seems VALUE ± SD `shown` `off`: `mend`"; `factor` are so many shown units in one published.
    Where there is an `off_below`, VALUE has no sign, and a negative one reads `off_below` in place of `off`.
    """

    name: str
    unit: str
    meaning: str
    what: str
    shown: str
    factor: float
    off: str
    mend: str
    off_below: str = ""


def _of_each_pad(row: RigConstant) -> Iterator[RigConstant]:
    for palm in PALMS:
        yield replace(row, **{name: getattr(row, name).format(palm) for name in ("name", "meaning", "what")})


RIG_TABLE: tuple[RigConstant, ...] = (
    *_of_each_pad(RigConstant("pad{}_zero_m", "m", "what pad {} reads at the hinge",
                              "pad {}'s zero", " mm", 1e3, "off", "palmd calibrate self finds its zero_mm")),
    *_of_each_pad(RigConstant("pad{}_scale", "", "by which share pad {} reads too much",
                              "pad {}'s scale", " %", 1e2, "off", "palmd calibrate pads measures its counts_per_mm")),
    *_of_each_pad(RigConstant("pad{}_sagitta_m", "m", "by how much pad {}'s middle is higher than its ends",
                              "pad {}'s middle", " mm", 1e3, "higher than its ends", "see that it lies flat",
                              "lower than its ends")),
    *_of_each_pad(RigConstant("pad{}_lag_s", "s", "by how much pad {}'s readings are older than their time",
                              "pad {}'s time", " ms", 1e3, "late", "see to its adapter's latency timer", "early")),
    *_of_each_pad(RigConstant("pad{}_standoff_m", "m", "how high pad {}'s surface is above the hinge line",
                              "pad {}'s surface", " mm", 1e3, "above the hinge line", "see how it is mounted",
                              "below the hinge line")),
    RigConstant("phi1_rad", "rad", "by how much palm 1 is steeper against gravity than reported",
                "palm 1's angle to gravity", "°", math.degrees(1), "off", "palmd calibrate self finds the arm's yaw"),
    RigConstant("phi2_rad", "rad", "by how much the opening of the palms is larger than reported",
                "the palms' opening", "°", math.degrees(1), "off",
                "palmd calibrate arm, and see that the pads lie along the palms"),
    RigConstant("friction_asymmetry", "", "(μ1 − μ2)/(μ1 + μ2) of the palms' friction",
                "palm 1's friction", " %", 1e2, "above the mean of both palms'", "clean both if they should be alike",
                "below the mean of both palms'"),
    *_of_each_pad(RigConstant("pad{}_force_m_per_n", "m/N", "by how much a reading of pad {} moves with its force",
                              "pad {}'s reading", " mm/N", 1e3, "off with the contact's force",
                              "see that nothing gives under it")),
    RigConstant("vibration_kappa", "", "by how much the mean product of both palms' slip signs is more than described",
                "the relation κ of the palms' vibrations", "", 1.0, "off", "set rig.vibration.relation"),
    RigConstant("vibration_transmission", "", "by how much more of friction's alternation the normal forces follow",
                "the transmission λ of the vibration", "", 1.0, "off", "set rig.vibration.transmission"),
    RigConstant("vibration_period", "", "by which share the vibration's period is longer than described",
                "the period of the palms' vibration", " %", 1e2, "off", "set rig.vibration.frequency_hz"),
    RigConstant("friction_arm", "", "by which share friction's arm about the middle is longer than the radius",
                "friction's arm", " %", 1e2, "off", "see that the palms vibrate along themselves"),
)  # fmt: skip
RIG_NAMES = tuple(constant.name for constant in RIG_TABLE)


def prior_sds(rig: RigDescription) -> FloatArray:
    """One-sigma of each constant before any reading, in the order of `RIG_TABLE`."""
    of_pads = [[pad.zero_sd, pad.scale_sd, pad.sagitta_sd, pad.lag_sd, pad.standoff_sd] for pad in rig.pads]
    of_angles = math.hypot(rig.angle_sd, rig.gravity_sd), rig.angle_sd
    vibration = rig.vibration
    of_vibration = vibration.kappa_sd, vibration.likeliest_transmission_sd, vibration.period_sd, vibration.arm_sd
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
    """Whether nothing that calibration measures is left open; how alike the palms rub is no matter of calibration."""
    return not prior_sds(rig)[: RIG_NAMES.index("friction_asymmetry")].any()


def told(sds: FloatArray, priors: FloatArray) -> npt.NDArray[np.bool_]:
    """Which constants readings have told, by their one-sigmas now and beforehand."""
    return sds < TOLD * priors


def said_off(values: FloatArray, sds: FloatArray, priors: FloatArray, contradicted: FloatArray) -> list[str]:
    """What is off beyond doubt, in plain words with what to do: only of constants that readings have told.

    values, sds, priors: of each constant, what it is off by, its one-sigma now and beforehand; SI, as `RIG_TABLE`.
    contradicted: not 0 where the readings speak against what is believed beforehand, be it that it is this constant or
    another of those.
    """
    sure = told(sds, priors) & (np.abs(values) > SURE * sds)
    said = []
    for i in np.flatnonzero(sure | (contradicted != 0.0)):
        constant, found = RIG_TABLE[i], shown(RIG_TABLE[i], float(values[i]), float(sds[i]))
        seems = "seems" if abs(values[i]) > OTHERS * sds[i] else "may be what is off, and seems"
        off, found = constant.off, found if not constant.off_below else found.lstrip("+-")
        off = constant.off_below if constant.off_below and values[i] < 0.0 else off
        said.append(f"{constant.what} {seems} {found} {off}: {constant.mend}")
    return said


def shown(constant: RigConstant, value: float, sd: float) -> str:
    """A constant's value with its one-sigma (SI) in the unit that people are shown, as many digits as are known."""
    value, sd = constant.factor * value, constant.factor * sd
    digits = max(-math.floor(math.log10(sd)), 0)  # one of the one-sigma's
    return f"{value:+z.{digits}f} ± {sd:.{digits}f}{constant.shown}"
