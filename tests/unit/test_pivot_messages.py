import math
from pathlib import Path

import numpy as np
import pytest

from palmd import pivot_messages as says
from palmd.daemon.pivot_system import PivotGrasp
from palmd.events import PadSample
from palmd.messages import stamp
from palmd.pivot_quantities import PIVOT_INFO
from palmd.system.pivot import PivotAnswer, PivotEstimate
from palmd.yamlfile import load_any_config
from tools.published import validate

ROOT = Path(__file__).parents[2]


@pytest.fixture
def config():
    return load_any_config(ROOT / "config/pivot.yaml")


def stamped(fields):
    return stamp(fields, 1.0, 2.0, 3)


def test_a_second_pad_is_not_read_as_the_first():
    fields = says.events_fields(7.0, (PadSample(0.1, 1, 0.0213),))
    with pytest.raises(ValueError, match="source is 2"):
        says.events_of(fields | {"source": [2]})


def test_a_rejected_answer_is_decoded_empty():
    none = np.zeros(0)
    rejected = PivotAnswer(1.5, False, "too little", math.nan, none, np.zeros((0, 0)), none, none, "undetermined")
    fields = says.answer_fields(2.0, rejected)
    back = says.answer_of(fields)
    assert (back.accepted, back.reason, back.p.size, back.covariance.shape) == (False, "too little", 0, (0, 0))
    assert back.reason_code == says.ANSWERS.unpacked(*says.ANSWERS.packed(rejected)).reason_code == "undetermined"
    del fields["reason_code"]  # as in older recordings
    assert says.answer_of(fields).reason_code == ""


def estimate(**changed):
    values = dict.fromkeys(("x", "z", "s", "e", "psi", "omega0", "f", "mu", "moment", "nis", "touched"), 0.01)
    fields = {"valid": True, "observer": "pivot", "object_count": 1, "side": 1, "reason": "", "sd": {}}
    return PivotEstimate(t=1.0, **(values | fields | changed))


def test_a_valid_estimate_needs_orientation_and_rate_with_their_sd(config):
    is_finite = PivotGrasp(config).is_finite
    assert is_finite(estimate(sd={"psi": 0.1, "omega0": 0.2}))
    assert not is_finite(estimate(sd={"psi": 0.1}))
    assert not is_finite(estimate(psi=math.nan, sd={"psi": 0.1, "omega0": 0.2}))


def test_the_rig_is_published_as_configured(config):
    fields = says.info_fields("1", "pivot", config, ["explore.yaml"])
    assert not validate(PIVOT_INFO, stamped(fields))
    assert fields["z_limits_m"] == pytest.approx([0.006, 0.045])
