"""From a filter's numbers to the published estimate. Pure, safe inside the loop."""

from __future__ import annotations

import math

from palmd.events import Estimate, FloatArray, PalmMotion
from palmd.model.outputs import NAMED
from palmd.observer.mass import MassEstimator
from palmd.system.mechanism import FORCES, JOINT_RATES, JOINTS

_UNKNOWN = dict.fromkeys((*NAMED, "mass", "nis", "observability"), math.nan)
_UNKNOWN_SD = dict.fromkeys((*NAMED, "mass"), math.nan)


def answer(
    t: float, valid: bool, observer: str, object_count: int,
    y: FloatArray, sd: FloatArray, mass: MassEstimator, nis: float, observability: float, touched: float,
) -> Estimate:  # fmt: skip
    """The estimate with values `y` and one-sigmas `sd` of `NAMED` (SI); forces become newtons by F = m f."""
    values = dict(zip(NAMED, (float(v) for v in y), strict=True))
    sds = dict(zip(NAMED, (float(v) for v in sd), strict=True))
    m, m_sd = mass.value, mass.sd
    for name in FORCES:
        f = values[name]
        values[name], sds[name] = m * f, math.hypot(m * sds[name], m_sd * f)
    sds["mass"] = m_sd
    return Estimate(
        t=t, valid=valid, observer=observer, object_count=object_count,
        mass=m, nis=nis, observability=observability, touched=touched, sd=sds, **values,
    )  # fmt: skip


def no_answer(t: float, observer: str, object_count: int, palms: PalmMotion | None) -> Estimate:
    """The estimate when nothing is known but, perhaps, the palms; NaN elsewhere."""
    known = {} if palms is None else dict(zip((*JOINTS, *JOINT_RATES), (*palms.angles, *palms.rates), strict=True))
    return Estimate(
        t=t, valid=False, observer=observer, object_count=object_count, touched=0.0,
        sd=dict(_UNKNOWN_SD), **{**_UNKNOWN, **known},
    )  # fmt: skip
