"""The table of quantities is complete and consistent with messages."""

import dataclasses
import math

import pytest

from palmd.events import Estimate
from palmd.quantities import BODY, CHARTS, ESTIMATE, IMPROVEMENT, LOOP, STAMP, STATE, TRUTH, drawn
from palmd.rig.world import World, default_config
from palmd.three_palms_quantities import PALM3
from palmd.topics import RIG_TOPICS, TOPICS, truth_of

SUFFIXES = {"m": "_m", "rad": "_rad", "rad/s": "_rad_s", "rad/s²": "_rad_s2", "kg": "_kg", "N": "_n", "s": "_s",
    "ms": "_ms", "ns": "_ns", "Hz": "_hz", "MB": "_mb", "m/s": "_m_s", "m/s²": "_m_s2", "m²/s": "_m2_s", "m²": "_m2",
    "m/N": "_m_per_n", "1/m": "_per_m", "kg m": "_kg_m"}  # fmt: skip
EVERYTHING = [(topic, quantity) for topic in (*TOPICS, *RIG_TOPICS) for quantity in topic.quantities]


@pytest.mark.parametrize(("topic", "quantity"), EVERYTHING, ids=lambda each: each.name)
def test_a_name_ends_in_its_unit(topic, quantity):
    if quantity.unit and quantity.unit != "SI" and quantity.name != "timestamp":
        assert quantity.name.endswith(SUFFIXES[quantity.unit])


def test_names_are_unique_within_a_topic():
    for topic in (*TOPICS, *RIG_TOPICS):
        names = [quantity.name for quantity in (*STAMP, *topic.quantities)]
        assert len(set(names)) == len(names), topic.name


def test_every_drawn_quantity_has_a_chart():
    known = {chart.name for chart in CHARTS}
    assert {quantity.chart for _, quantity in EVERYTHING} - {""} == known
    for chart in CHARTS:
        found = [(topic, quantity) for topic, quantity in EVERYTHING if quantity.chart == chart.name]
        assert len({quantity.unit for _, quantity in found}) == 1, chart.name
        if chart.span is not None:
            drawn_of = [topic for topic in (ESTIMATE, PALM3) if any(drawn(topic, chart=chart.name))]
            assert drawn_of, f"{chart.name} is an empty strip"


def test_every_field_of_an_estimate_is_the_source_of_a_quantity():
    known = {field.name for field in dataclasses.fields(Estimate)} - {"t", "sd"}
    assert {quantity.source for quantity in ESTIMATE.quantities} - {""} == known


def test_quantities_with_an_sd_have_unique_symbols_and_labels():
    uncertain = [quantity for quantity in ESTIMATE.quantities if quantity.uncertain]
    assert len({quantity.symbol for quantity in uncertain} - {""}) == len(uncertain)
    assert ESTIMATE["r1_m"].label == "r₁ (mm)"
    assert ESTIMATE["mu"].label == "μ"
    with pytest.raises(KeyError, match="palm/estimate has no r3_m"):
        ESTIMATE["r3_m"]


def test_the_allowed_age_of_a_topic_follows_from_its_rate():
    assert (ESTIMATE.stale_s, STATE.stale_s, LOOP.stale_s, IMPROVEMENT.stale_s) == (0.5, 0.5, 3.0, math.inf)
    assert (ESTIMATE.rate, STATE.rate, LOOP.rate) == ("100 Hz, every tick", "10 Hz, and on change", "1 Hz")


def test_the_rigs_truth_has_the_quantities_of_its_topics():
    world = World(default_config(), 1)
    assert set(world.truth()) == {quantity.name for quantity in TRUTH.quantities}
    assert set(world.object_truth()) == {quantity.name for quantity in BODY.quantities}
    topics = [truth_of(ESTIMATE[name]) for name in ("r1_m", "rho_m", "v1_m", "touched")]
    assert topics == [TRUTH, BODY, None, None]
