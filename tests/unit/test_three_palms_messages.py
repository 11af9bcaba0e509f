import math
from pathlib import Path

import msgpack
import numpy as np
import pytest

from palmd import three_palms_messages as says
from palmd.daemon.packing import FieldsPacker
from palmd.events import PadLift, PadSample, PalmSample
from palmd.messages import PadView, contact_fields, stamp
from palmd.system.three_palms import NAMING, BodyAnswer, BodyEstimate
from palmd.three_palms_quantities import PALM3, PALM3_ANSWER, PALM3_CONTACT, PALM3_EVENTS, PALM3_INFO
from palmd.yamlfile import load_any_config
from tools.published import validate

ROOT = Path(__file__).parents[2]


def stamped(fields):
    return stamp(dict(fields), 1.0, 2.0, 3)


def test_events_are_decoded_bit_for_bit_with_both_coordinates():
    events = (
        PadSample(0.1, 1, 0.0213, 0.4, -0.011),
        PadSample(0.2, 3, 0.0214, None, 0.007),
        PadLift(0.3, 2),
        PalmSample(0.4, (0.9, 0.8, 0.7)),
        PalmSample(0.5, (0.9, 0.8, 0.7), (1e-3, -2e-3, 0.0), (0.1, math.pi, 0.2)),
    )
    fields = says.events_fields(7.0, events)
    assert says.events_of(fields) == events
    assert fields["b_m"][0] == 0.0213
    assert fields["a_m"][0] == -0.011
    assert not validate(PALM3_EVENTS, stamped(fields))


def test_an_answer_is_decoded_bit_for_bit():
    rng = np.random.default_rng(1)
    sent = BodyAnswer(
        1.5, 0.2, True, "", 2, rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=90),
        rng.normal(size=(96, 96)), rng.random(9), rng.random(9), np.ones(9), rng.random(9), 0.06, 0.001, 3e-5, "other",
    )  # fmt: skip
    fields = msgpack.unpackb(FieldsPacker()(says.answer_fields(2.0, sent)))
    back = says.answer_of(fields)
    for name in BodyAnswer.__slots__:
        assert np.array_equal(getattr(back, name), getattr(sent, name)), name
    assert not validate(PALM3_ANSWER, stamped(fields))
    del fields["unexplained_sd_m"], fields["reason_code"]  # as in older recordings
    assert (says.answer_of(fields).unexplained_sd, says.answer_of(fields).reason_code) == (0.0, "")


def test_every_field_of_an_estimate_is_in_its_table_and_vice_versa():
    nan = (math.nan,) * 4
    estimate = BodyEstimate(
        1.0, False, "space", 1, 1.0, sd={"com_z_m": 1e-5}, values={"com_z_m": 0.03}, quaternion=nan,
        attitude_sd=nan[1:], touched=0.0, hypotheses=0, reason="nothing yet",
    )  # fmt: skip
    fields = says.estimate_fields(estimate)
    assert not validate(PALM3, stamped(fields))
    assert fields["com_z_m"] == 0.03
    assert fields["invalid_reasons"] == ["no-answer"]
    assert math.isnan(fields["f3_n"])


def test_the_rig_is_published_as_configured():
    config = load_any_config(ROOT / "config/three_palms.yaml")
    fields = says.info_fields("1", "space", config, [])
    assert not validate(PALM3_INFO, stamped(fields))
    assert [fields[f"pad{n}_centre_m"][0] for n in NAMING.pads] == pytest.approx([0.0, 0.0375, 0.0375])


def test_contacts_are_published_with_both_coordinates():
    views = [PadView(s=0.02, across=-0.003), PadView(), PadView()]
    fields = contact_fields(views, 0.01, NAMING)
    assert not validate(PALM3_CONTACT, stamped(fields))
    assert (fields["b1_m"], fields["a1_m"]) == (0.02, -0.003)
