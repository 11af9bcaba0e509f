"""Former names work beside the standard ones, and no other published name is a private word."""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq
from test_language import private_words

from palmd import three_palms_messages
from palmd.aliases import (
    ALIASES,
    LIBRARY,
    PALM3_ANSWER,
    RIG,
    RIG_OPTIONS,
    SHAPE_CLASS,
    STATE,
    aliases_of,
    with_former_names,
    with_standard_names,
)
from palmd.api.answers import SmoothedRun
from palmd.bus.subscriber import Subscriber
from palmd.config.two_palms import PlanSpec
from palmd.daemon.packing import FieldsPacker
from palmd.messages import Fields, rig_fields, state_fields
from palmd.observer.shape_classification import ShapeClass, as_json
from palmd.record.mcapfile import RawMessage
from palmd.rig import app
from palmd.system.rig_constants import RIG_NAMES
from palmd.system.three_palms import BodyAnswer
from palmd.topics import TOPICS
from palmd.view.page_quantities import page_quantities
from tools import promises

TOPIC_NAMES = {topic.name: topic for topic in TOPICS}
OF_TOPICS = [alias for alias in ALIASES if alias.where in TOPIC_NAMES]


def an_answer() -> BodyAnswer:
    numbers = np.arange(9.0)
    return BodyAnswer(1.5, 0.25, True, "", 2, numbers.reshape(3, 3), numbers, numbers, np.eye(96), numbers, numbers,
                      numbers, numbers, 0.06, 0.001, 3e-5)  # fmt: skip


def test_a_topic_has_both_names_with_the_same_unit() -> None:
    for where, standard, former, _ in OF_TOPICS:
        names = [TOPIC_NAMES[where][name] for name in (standard, former)]
        assert len({(each.kind, each.unit) for each in names}) == 1, former
    assert {alias.where for alias in ALIASES if "/" in alias.where} <= TOPIC_NAMES.keys()


def test_messages_have_both_names() -> None:
    rows = np.full(len(RIG_NAMES), 1e-2)
    state = state_fields("hold", (), requested_state="hold")
    rig = rig_fields(rows, rows * 1e-2, rows, np.full(len(RIG_NAMES), 9.0))
    answer = three_palms_messages.answer_fields(2.0, an_answer())
    assert (state["wish"], state["requested_state"]) == ("hold", "hold")
    assert len(rig["contradictions"]) > 0
    assert rig["off"] == rig["contradictions"]
    for alias in aliases_of(PALM3_ANSWER):
        assert answer[alias.former] == answer[alias.standard]


def as_published_before(where: str, fields: Fields) -> Fields:
    """A message with former names only."""
    return {name: value for name, value in fields.items() if name not in {each.standard for each in aliases_of(where)}}


def test_recordings_with_former_names_are_read() -> None:
    answer = an_answer()
    old = as_published_before(PALM3_ANSWER, three_palms_messages.answer_fields(2.0, answer))
    assert "record_start_s" not in old
    read = three_palms_messages.answer_of(RawMessage(PALM3_ANSWER, 0, 0, 0, FieldsPacker()(old)).fields)
    for name in BodyAnswer.__slots__:
        assert np.array_equal(getattr(read, name), getattr(answer, name)), name


@pytest.mark.parametrize("alias", OF_TOPICS, ids=lambda alias: f"{alias.where} {alias.former}")
def test_a_message_with_the_former_name_is_received(alias: Any, tmp_path: Any) -> None:
    address = f"ipc://{tmp_path}/publish"
    with zmq.Context() as context, context.socket(zmq.XPUB) as socket:
        socket.linger = 0
        socket.bind(address)
        with Subscriber(address, topics=(alias.where,)) as subscriber:
            socket.recv()  # the subscription
            socket.send_multipart([alias.where.encode(), msgpack.packb({alias.former: 7}), b"1.0"])
            message = next(subscriber.until(time.monotonic() + 20.0))
    assert message.fields == {alias.former: 7, alias.standard: 7}


def test_a_published_standard_name_counts_more_than_a_former_one() -> None:
    assert with_standard_names(STATE, {"requested_state": "stop", "wish": "hold"})["requested_state"] == "stop"


def test_the_page_knows_the_former_fields() -> None:
    former = page_quantities()["former"]
    assert former[RIG] == {"off": "contradictions"}
    assert {(where, each) for where, names in former.items() for each in names} == {
        (alias.where, alias.former) for alias in OF_TOPICS
    }


def test_a_shape_class_has_both_names() -> None:
    fields: dict[str, Any] = as_json(ShapeClass(**{
        each.name: "" if each.type == "str" else () if "tuple" in str(each.type) else math.nan
        for each in dataclasses.fields(ShapeClass)
    }))  # fmt: skip
    assert fields == with_former_names(SHAPE_CLASS, dict(fields))
    assert fields.keys() >= {"text", "said", "orientation_determined", "orientation_told"}


def test_attributes_of_the_library_have_both_names() -> None:
    run = SmoothedRun(**{each.name: f"the {each.name}" for each in dataclasses.fields(SmoothedRun)})  # type: ignore[arg-type]
    for alias in aliases_of(LIBRARY):
        assert getattr(run, alias.former) == getattr(run, alias.standard) == f"the {alias.standard}"


def test_options_have_both_spellings_and_help_shows_the_standard_one() -> None:
    parser = argparse.ArgumentParser()
    app.add_arguments(parser)
    for alias in aliases_of(RIG_OPTIONS):
        assert parser.parse_args([alias.former, "drop", alias.standard, "swap"]).inject == ["drop", "swap"]
        assert alias.standard in parser.format_help()
        assert alias.former not in parser.format_help()
    assert parser.parse_args([]).inject == []


def names(promised: Any) -> Iterator[str]:
    """Every name in a part of what is promised."""
    if isinstance(promised, str):
        yield promised
    elif isinstance(promised, dict):
        for name, part in promised.items():
            yield name
            yield from names(part)
    elif isinstance(promised, list):
        for each in promised:
            yield from names(each)


def test_no_other_promised_name_is_a_private_word() -> None:
    plans = sorted({*PlanSpec.model_json_schema()["$defs"], *_keys(PlanSpec.model_json_schema())})
    former = {alias.former for alias in ALIASES}
    found = {name for name in (*names(promises.promised()), *plans) if private_words(name)}
    assert found - former == set()


def _keys(schema: Any) -> Iterator[str]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for part in schema.values():
            yield from _keys(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from _keys(part)
