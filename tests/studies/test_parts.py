"""The bound for other parts: what is thinned, what is told, and that better parts are better."""

from collections import Counter
from pathlib import Path

import pytest

from palmd.events import PadLift, PadSample, PalmSample
from palmd.yamlfile import load_config
from tools.studies.bench_parts import table
from tools.studies.parts import LOOKED_AT, Parts, rows, thinned

CONFIG = load_config(Path(__file__).parents[2] / "config/tabletop.yaml")


def test_each_kind_of_reading_is_thinned_by_itself_and_no_lift_off_is_lost():
    events = []
    for i in range(60):
        events += [PadSample(0.01 * i, 1, 0.02), PalmSample(0.01 * i, (1.0, 1.0))]
        events += [PadSample(0.01 * i, 2, 0.02)] if i % 2 else [PadLift(0.01 * i, 2)]
    kept = thinned(events, 5)
    counts = Counter((type(event), getattr(event, "pad", 0)) for event in kept)
    assert counts == {(PadSample, 1): 12, (PalmSample, 0): 12, (PadSample, 2): 6, (PadLift, 2): 30}
    assert thinned(events, 1) == events


def test_parts_change_what_they_name_and_nothing_else():
    plain = Parts("plain").described(CONFIG)
    better = Parts("better", noise_mm=0.05, standoff_mm=0.01).described(CONFIG)
    assert [pad.noise for pad in better.pads] == [5e-5, 5e-5]
    assert [pad.standoff_sd for pad in better.pads] == [1e-5, 1e-5]
    assert better.angle_sd == plain.angle_sd
    assert Parts("no play", backlash_deg=0.0).described(CONFIG).angle_sd < plain.angle_sd


def test_better_parts_are_better_and_the_table_tells_all():
    made = list(rows(CONFIG, "rig", [0], 4.0))
    by_name = {row.parts.name: row.h_sd_m for row in made}
    usual = by_name["as configured"]
    assert by_name["strips of 0.05 mm"] < usual < by_name["strips of 0.3 mm"]
    assert by_name["no play"] < usual < by_name["play of 0.5°"] < by_name["play of 1°"]
    assert by_name["half as many readings"] > usual
    assert min(by_name.values()) == pytest.approx(by_name[LOOKED_AT[-1].name])
    assert len(table(made).splitlines()) == len(LOOKED_AT) + 1
