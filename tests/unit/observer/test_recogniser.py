"""Which of several similar outlines it is, or none: right, soon, with probabilities that mean something."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
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


def said(t, *probability, names=("a", "b")):
    return ObjectEstimate(t, names, np.array(probability[:-1]), probability[-1], 1)


# ---- runs


@pytest.mark.parametrize(("kind", "seed"), [("nominal", 21), ("friction", 22), ("rig", 23), ("odd", 20)])
def test_the_right_one_of_many_is_found_within_three_seconds(kind, seed):
    bodies, outlines = library(kind, seed, 8)
    chosen = seed % 8
    run = run_with(bodies[chosen], kind, seed, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    told = []
    for tick in replay(run.log, recogniser):
        told.append(recogniser.identify(tick.t))
        if told[-1] is not None:
            assert told[-1].probability.sum() + told[-1].none == pytest.approx(1.0)
        if tick.estimate.valid:
            assert told[-1].best, "nothing is valid while it is undecided"
    found = verdict(each for each in told if each is not None)
    assert found.decision == outlines[chosen].name
    assert found.decided_at < 2.5


@pytest.mark.parametrize(("kind", "seed"), [("friction", 32), ("rig", 33), ("odd", 34)])
def test_a_sibling_that_is_not_stored_is_none_of_them(kind, seed):
    bodies, outlines = library(kind, seed, 8)
    run = run_with(bodies[0], kind, seed, 4.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines[1:])
    found = verdict(e for tick in replay(run.log, recogniser) if (e := recogniser.identify(tick.t)) is not None)
    assert found.decision == NONE_OF_THESE


def test_before_the_twins_begin_none_has_its_prior():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    for tick in itertools.islice(replay(run.log, recogniser), 50):
        assert not tick.estimate.valid
    assert recogniser.identify(0.5).none == pytest.approx(NONE)


def test_nothing_is_said_before_anything_is_felt():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    recogniser = observer.make("shape", run.log.rig, outlines=outlines)
    assert recogniser.identify(0.0) is None
    recogniser.warm_up()
    assert recogniser.identify(0.0) is None


def test_no_name_is_given_while_nothing_foresees_the_readings():
    """Of a body that slips easily (μ 0.07), which is recognised for good before its readings are disturbed."""
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


# ---- what is said of a run


def test_a_verdict_stands_since_it_was_said_for_good():
    found = verdict(
        [said(0.1, 0.97, 0.01, 0.02), said(0.2, 0.5, 0.5, 0.0), said(0.3, 0.96, 0, 0), said(0.4, 0.99, 0, 0)]
    )
    assert (found.decision, found.decided_at) == ("a", 0.3)
    found = verdict([said(0.1, 0.96, 0.0, 0.04), said(0.2, 0.0, 0.03, 0.97)])
    assert (found.decision, found.decided_at) == (NONE_OF_THESE, 0.2)
    assert as_line(found)["best"] == ""
    assert as_line(found)["decided_s"] == 0.2
    found = verdict([said(0.1, 0.94, 0.0, 0.06)])
    assert found.decision == ""
    assert math.isnan(found.decided_at)
    assert as_line(found)["decided_s"] is None
    assert verdict([]) is None


def test_the_table_begins_with_the_likeliest():
    text = table(verdict([said(0.1, 0.01, 0.98, 0.01)])).splitlines()
    assert text[0].split() == ["b", "0.980"]
    assert text[2].split() == ["none", "of", "these", "0.010"]
    assert text[3] == "b, since 0.10 s"
    assert table(verdict([said(0.1, 0.5, 0.4, 0.1)])).endswith("undecided")


def test_the_message_is_that_of_the_table():
    fields = stamp(object_fields(said(0.1, DECIDED, 0.03, 0.02)), 1.0, 0.1, 1)
    assert validate(OBJECT, fields) == []
    assert fields["best"] == "a"
    assert object_fields(said(0.1, DECIDED - 0.01, 0.04, 0.02))["best"] == ""


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


def test_a_replay_tells_it_each_second():
    bodies, outlines = library("friction", 22, 8)
    run = run_with(bodies[6], "friction", 22, 3.0)
    told = [
        line
        for tick in replay(run.log, observer.make("shape", run.log.rig, outlines=outlines))
        for line in lines(tick_fields(tick))
    ]
    objects = [line for line in told if isinstance(line.get("object"), dict)]
    assert [line["t"] for line in objects] == pytest.approx([1.0, 2.0])
    assert objects[-1]["object"]["best"] == outlines[6].name
