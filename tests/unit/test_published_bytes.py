"""The bytes of published messages, frozen: order of the fields, types and values, of every system.

Inputs are exact and only units are computed, so that every machine gives these bytes. A changed digest is a change of
the bus protocol and of every recording: it needs a reason in its commit.
"""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import pytest

from palmd import messages, pivot_messages, three_palms_messages
from palmd.config.any_config import config_hash
from palmd.console.shipped import shipped
from palmd.daemon.packing import FieldsPacker
from palmd.events import Estimate, Improvement, PadLift, PadSample, PalmSample, ShapeEstimate
from palmd.system.pivot import PivotAnswer, PivotEstimate
from palmd.system.reasons import Code
from palmd.system.three_palms import BodyAnswer, BodyEstimate
from palmd.three_palms_messages import VALUES
from palmd.yamlfile import load_any_config

ONE = (PadSample(0.25, 1, 0.5, 0.125), PadSample(0.5, 1, 0.75), PadLift(0.625, 1))
DEGREES = np.arange(360) / 256


def numbers(*shape: int) -> np.ndarray:
    return np.arange(1.0, np.prod(shape) + 1.0).reshape(shape) / 64


def filled(kind, **given):
    """A dataclass with a distinct number in each field that is not given."""
    names = [each.name for each in dataclasses.fields(kind)]
    return kind(**{name: given.get(name, (i + 1) / 8) for i, name in enumerate(names)})


def info(says, name):
    config = load_any_config(shipped(name))
    fields = says.info_fields("1.2.3", "shape", config, ["one.yaml", "two.yaml"])
    assert fields["config_hash"] == config_hash(config)
    return fields | {"config_hash": "of this configuration"}


def shape(size=360):
    return ShapeEstimate(1.5, DEGREES[:size], DEGREES[:size] / 2, DEGREES[:size] / 4, DEGREES[:size] > 0.5)


SD = {"psi": 0.5, "omega0": 0.25}
REASON = {
    "valid": False, "reason": "too little, as yet", "invalid_reasons": (Code.OTHER,), "sd": SD, "object_count": 3,
    "observer": "shape",
}  # fmt: skip
TWO = filled(Estimate, valid=True, sd=SD, object_count=3, observer="shape", invalid_reasons=())
PIVOT = filled(PivotEstimate, **REASON, side=-1)
BODY = BodyEstimate(
    **{each.name: None for each in dataclasses.fields(BodyEstimate)} | REASON | {
        "t": 1.5, "quaternion": (0.0, 0.5, 0.25, 1.0), "attitude_sd": (0.5, 0.25, 0.125), "nis": 0.75, "touched": 0.5,
        "values": {name: i / 16 for i, name in enumerate(VALUES[3:])}, "hypotheses": 2,
        "sd": {"mu": 0.25},
    }
)  # fmt: skip

MESSAGES = {
    "palm/estimate": lambda: messages.estimate_fields(TWO),
    "palm/estimate at a glance": lambda: messages.estimate_summary(TWO),
    "palm/shape": lambda: messages.shape_fields(shape()),
    "palm/events": lambda: messages.events_fields(
        2.0, (*ONE, PalmSample(0.75, (0.5, 0.25)), PalmSample(0.875, (0.5, 0.25), (1.0, 2.0), (3.0, 4.0)))
    ),
    "palm/improvement": lambda: messages.improvement_fields(
        2.0,
        Improvement(1.5, numbers(21), numbers(21, 21), 4, True, DEGREES[:72] > 0.1, numbers(15), numbers(15),
                    numbers(36, 15), numbers(15)),
    ),
    "palm/info": lambda: info(messages, "demo.yaml"),
    "palm/pivot": lambda: pivot_messages.estimate_fields(PIVOT),
    "palm/pivot at a glance": lambda: pivot_messages.estimate_summary(PIVOT),
    "palm/pivot_shape": lambda: pivot_messages.shape_fields(shape()),
    "palm/pivot_events": lambda: pivot_messages.events_fields(2.0, (*ONE, PalmSample(0.75, (0.5, 0.25)))),
    "palm/pivot_answer": lambda: pivot_messages.answer_fields(
        2.0, PivotAnswer(1.5, True, "", 0.5, numbers(9), numbers(9, 9), DEGREES, np.floor(DEGREES), "")
    ),
    "palm/pivot_info": lambda: info(pivot_messages, "pivot.yaml"),
    "palm3/estimate": lambda: three_palms_messages.estimate_fields(BODY),
    "palm3/estimate at a glance": lambda: three_palms_messages.estimate_summary(BODY),
    "palm3/shape": lambda: three_palms_messages.shape_fields(shape(), 3, True),
    "palm3/events": lambda: three_palms_messages.events_fields(
        2.0, (PadSample(0.25, 3, 0.5, 0.125, 0.25), PadLift(0.5, 2), PalmSample(0.75, (0.5, 0.25, 0.125)))
    ),
    "palm3/answer": lambda: three_palms_messages.answer_fields(
        2.0,
        BodyAnswer(1.5, 0.25, True, "", 2, numbers(3, 3), numbers(3), numbers(90), numbers(96, 96), DEGREES, DEGREES,
                   np.floor(DEGREES), numbers(9), 0.25, 0.125, 0.5, ""),
    ),
    "palm3/info": lambda: info(three_palms_messages, "three_palms.yaml"),
}  # fmt: skip

FROZEN = {
    "palm/estimate": (525, "9e00a723da14aac2"),
    "palm/estimate at a glance": (353, "7f65c7201ede6500"),
    "palm/shape": (10162, "b570d4ad63ee322c"),
    "palm/events": (581, "a6c7d8d529543ac8"),
    "palm/improvement": (9654, "3b37ba9141b7adeb"),
    "palm/info": (685, "143418edb168bc74"),
    "palm/pivot": (340, "b5d0be97774be507"),
    "palm/pivot at a glance": (283, "9e3ba9380ca1c5ae"),
    "palm/pivot_shape": (10164, "4371f6e573fbb7b9"),
    "palm/pivot_events": (465, "6567bcd9e9750341"),
    "palm/pivot_answer": (4578, "a2771c5f0661851d"),
    "palm/pivot_info": (396, "959d0cc4fdb83397"),
    "palm3/estimate": (863, "6680b7b2df08f4a4"),
    "palm3/estimate at a glance": (290, "db24839e85b63e58"),
    "palm3/shape": (6934, "f022b4f22ffc2be6"),
    "palm3/events": (598, "494b8c4ef22040b1"),
    "palm3/answer": (93988, "77b8598585ea359b"),
    "palm3/info": (684, "eb62082f035bd1d3"),
}
"""By message: number of bytes, and the beginning of their sha256."""


@pytest.mark.parametrize("name", MESSAGES)
def test_messages_have_the_bytes_of_stored_recordings(name):
    fields = MESSAGES[name]()
    packed = FieldsPacker()(messages.stamp(fields, 1.0, 2.0, 3))
    assert (len(packed), hashlib.sha256(packed).hexdigest()[:16]) == FROZEN[name]
