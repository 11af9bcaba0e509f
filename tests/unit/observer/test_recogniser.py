"""Recognition among similar outlines, or of none: correct, fast, with calibrated probabilities."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from campaign import nightly
from library import library, run_with

from palmd import observer
from palmd.daemon.core import Core
from palmd.events import DECIDED, ObjectEstimate, PadSample
from palmd.messages import object_fields, stamp
from palmd.observer.recogniser import NONE
from palmd.quantities import OBJECT
from palmd.record.recognition import NONE_OF_THESE, as_line, table, verdict
from palmd.record.replay import lines, replay, tick_fields
from palmd.rig.world import default_config
from tools.published import validate


def identification(t, *probability, names=("a", "b")):
    return ObjectEstimate(t, names, np.array(probability[:-1]), probability[-1], 1)


# ---- runs


@pytest.mark.parametrize(("kind", "seed"), [("rig", 23), ("odd", 20), *nightly(("nominal", 21), ("friction", 22))])
def test_the_right_outline_is_found_within_three_seconds(kind, seed):
    bodies, outlines = library(kind, seed, 8)
    chosen = seed % 8
    run = run_with(bodies[chosen], kind, seed, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    identifications = []
    for tick in replay(run.log, recogniser):
        identifications.append(recogniser.identify(tick.t))
        if identifications[-1] is not None:
            assert identifications[-1].probability.sum() + identifications[-1].none == pytest.approx(1.0)
        if tick.estimate.valid:
            assert identifications[-1].best, "no estimate is valid before the decision"
    found = verdict(each for each in identifications if each is not None)
    assert found.decision == outlines[chosen].name
    assert found.decided_at < 2.5


@pytest.mark.parametrize(("kind", "seed"), [("rig", 33), *nightly(("friction", 32), ("odd", 34))])
def test_a_similar_object_that_is_not_stored_is_not_identified(kind, seed):
    bodies, outlines = library(kind, seed, 8)
    run = run_with(bodies[0], kind, seed, 4.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines[1:])
    found = verdict(e for tick in replay(run.log, recogniser) if (e := recogniser.identify(tick.t)) is not None)
    assert found.decision == NONE_OF_THESE


def test_before_the_twins_start_none_has_its_prior_probability():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    for tick in itertools.islice(replay(run.log, recogniser), 50):
        assert not tick.estimate.valid
    assert recogniser.identify(0.5).none == pytest.approx(NONE)


def test_without_contact_there_is_no_identification():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    assert recogniser.identify(0.0) is None
    recogniser.warm_up()
    assert recogniser.identify(0.0) is None


def test_no_outline_is_identified_while_none_predicts_the_readings():
    """A body with low friction (μ = 0.07) that is recognised before its readings are disturbed."""
    bodies, outlines = library("friction", 38, 8)
    run = run_with(bodies[6], "friction", 38, 3.0)
    recogniser, random = observer.make("shape", run.log.rig, outlines=outlines), np.random.default_rng(4)
    before, during = set(), []
    for event in run.log.events:
        t = event.t_sample
        if t > 1.5 and isinstance(event, PadSample):
            event = replace(event, s=event.s + random.normal(0.0, 3e-4))
        recogniser.feed(event)
        estimate, found = recogniser.estimate(t), recogniser.identify(t)
        if found is None:
            continue
        if 1.2 < t < 1.5:
            before.add(found.best)
        elif t > 1.5 and estimate.nis > 2.0:
            during.append(found)
    assert before == {outlines[6].name}
    assert len(during) > 50
    assert all(found.none == 1.0 for found in during)


# ---- the verdict on a run


def test_a_verdicts_time_is_that_of_its_last_change():
    found = verdict(
        [
            identification(0.1, 0.97, 0.01, 0.02),
            identification(0.2, 0.5, 0.5, 0.0),
            identification(0.3, 0.96, 0, 0),
            identification(0.4, 0.99, 0, 0),
        ]
    )
    assert (found.decision, found.decided_at) == ("a", 0.3)
    found = verdict([identification(0.1, 0.96, 0.0, 0.04), identification(0.2, 0.0, 0.03, 0.97)])
    assert (found.decision, found.decided_at) == (NONE_OF_THESE, 0.2)
    assert as_line(found)["best"] == ""
    assert as_line(found)["decided_s"] == 0.2
    found = verdict([identification(0.1, 0.94, 0.0, 0.06)])
    assert found.decision == ""
    assert math.isnan(found.decided_at)
    assert as_line(found)["decided_s"] is None
    assert verdict([]) is None


def test_the_table_is_sorted_by_probability():
    text = table(verdict([identification(0.1, 0.01, 0.98, 0.01)])).splitlines()
    assert text[0].split() == ["b", "0.980"]
    assert text[2].split() == ["none", "of", "these", "0.010"]
    assert text[3] == "b, since 0.10 s"
    assert table(verdict([identification(0.1, 0.5, 0.4, 0.1)])).endswith("undecided")


def test_the_message_agrees_with_the_table():
    fields = stamp(object_fields(identification(0.1, DECIDED, 0.03, 0.02)), 1.0, 0.1, 1)
    assert validate(OBJECT, fields) == []
    assert fields["best"] == "a"
    assert object_fields(identification(0.1, DECIDED - 0.01, 0.04, 0.02))["best"] == ""


# ---- published and replayed


def test_the_daemon_publishes_it_ten_times_a_second():
    outlines = library("friction", 22, 8)[1]
    bodies = library("friction", 22, 8)[0]
    run = run_with(bodies[6], "friction", 22, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    with ThreadPoolExecutor(1) as aside:
        core = Core(default_config(), recogniser, aside)
        waiting, published = list(reversed(run.log.events)), []
        for k in range(1, 101):
            while waiting and waiting[-1].t_sample <= k * 0.01:
                core._events.append(waiting.pop())
            published += [fields for topic, fields in core.step(k * 0.01) if topic is OBJECT]
    assert 8 <= len(published) <= 11
    assert published[-1]["best"] == outlines[6].name
    assert published[-1]["object"] == 1


def test_a_replay_writes_the_identification_each_second():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    identifications = [
        line
        for tick in replay(run.log, observer.make("shape", run.log.rig, outlines=outlines))
        for line in lines(tick_fields(tick))
    ]
    objects = [line for line in identifications if isinstance(line.get("object"), dict)]
    assert [line["t"] for line in objects] == pytest.approx([1.0, 2.0])
    assert objects[-1]["object"]["best"] == outlines[6].name
