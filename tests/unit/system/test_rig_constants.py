"""Names of the rig's constants, and when an error in one of them is reported."""

from dataclasses import replace

import numpy as np
import pytest

from palmd.model.smoothing import RIG_CONSTANTS, R
from palmd.system.description import AS_CALIBRATED, RigDescription
from palmd.system.rig_constants import RIG_NAMES, RIG_TABLE, describe_rig_errors, prior_sds

PRIORS = prior_sds(RigDescription().known_to(AS_CALIBRATED))


def reported_error(name: str, sigmas: float, left: float, contradicted: bool = False) -> list[str]:
    """Messages about one constant that is `sigmas` one-sigmas off;

    `left` is its posterior 1σ as a share of its prior 1σ.
    """
    sds = PRIORS.copy()
    sds[RIG_NAMES.index(name)] *= left
    values = np.zeros(RIG_CONSTANTS)
    values[RIG_NAMES.index(name)] = sigmas * sds[RIG_NAMES.index(name)]
    return describe_rig_errors(values, sds, PRIORS, contradicted * (values != 0.0))


def test_the_table_has_the_order_of_the_smoothers_constants():
    first = {R.ZERO: "zero_m", R.SCALE: "scale", R.SAGITTA: "sagitta_m", R.LAG: "lag_s", R.STANDOFF: "standoff_m",
             R.FORCE: "force_m_per_n"}  # fmt: skip
    for index, name in first.items():
        assert RIG_NAMES[index : index + 2] == (f"pad1_{name}", f"pad2_{name}")
    assert [RIG_NAMES[i] for i in (R.TILT, R.TURN, R.FRICTION)] == ["phi1_rad", "phi2_rad", "friction_asymmetry"]


UNCERTAIN = [constant for constant, sd in zip(RIG_TABLE, PRIORS, strict=True) if sd > 0.0]


@pytest.mark.parametrize("constant", UNCERTAIN, ids=lambda constant: constant.name)
def test_an_error_is_reported_only_if_the_readings_have_determined_it(constant):
    assert reported_error(constant.name, 3.9, 0.1) == reported_error(constant.name, 50.0, 0.65) == []
    (message,) = reported_error(constant.name, -4.1, 0.55)
    assert message.startswith(constant.subject)
    assert message.endswith(f"{constant.negative_error_text or constant.error_text}: {constant.remedy}")
    assert ("seems -" in message) == (not constant.negative_error_text)


def test_an_exactly_known_constant_is_never_reported():
    rig = RigDescription().known_to(AS_CALIBRATED)
    exact = prior_sds(replace(rig, pads=(replace(rig.pads[0], zero_sd=0.0), rig.pads[1])))
    values, sds = np.zeros(RIG_CONSTANTS), np.maximum(exact, 1e-9)
    values[0] = 1e-3
    assert describe_rig_errors(values, sds, exact, np.zeros(RIG_CONSTANTS)) == []


def test_a_contradicted_constant_is_reported_however_large_its_sd():
    (message,) = reported_error("pad1_scale", 2.0, 10.0, contradicted=True)
    assert message.startswith("pad 1's scale may be the cause, and seems +6 ± 3 %")


def test_an_error_is_reported_with_the_digits_that_its_sd_supports():
    assert reported_error("pad2_zero_m", 10.3, 0.31) == [
        "pad 2's zero seems +0.32 ± 0.03 mm off: palmd calibrate self finds its zero_mm"
    ]
    assert reported_error("pad1_lag_s", -7.0, 0.2) == [
        "pad 1's time seems 2.8 ± 0.4 ms early: check its adapter's latency timer"
    ]
    (message,) = reported_error("friction_asymmetry", 30.0, 0.04)
    assert message.startswith("palm 1's friction seems 36 ± 1 % above the mean of both palms'")
