"""That what was made fast is: ratios within one run, of things that take turns, so that a busy machine does no harm."""

import pytest

from tools.studies import bench_speed, speed
from tools.studies.speed import Contest, Figure, figure

TURNS = 5
GUARDED = [each for each in (*speed.kernels(), *speed.routines(), *speed.ticks()) if each.goal is not None]


@pytest.mark.parametrize("contest", GUARDED, ids=lambda each: each.name)
def test_it_is_as_much_faster_than_its_reference_as_it_was(contest):
    told = figure(contest, TURNS)
    assert told.met, f"{told.ratio:.2f} times as fast as {told.beside}, not {told.goal:g}"


def burnt(rounds):
    def work():
        return sum(range(rounds))

    return work


def test_a_ratio_is_of_what_both_do():
    even = figure(Contest("a", "b", burnt(20_000), burnt(20_000)), TURNS)
    assert even.ratio == pytest.approx(1.0, rel=0.3)
    thrice = figure(Contest("a", "b", burnt(20_000), burnt(60_000)), TURNS)
    assert thrice.ratio == pytest.approx(3.0, rel=0.3)
    each = figure(Contest("a", "b", burnt(60_000), burnt(20_000), (3.0, 1.0)), TURNS)
    assert each.ratio == pytest.approx(1.0, rel=0.3)


def test_real_time_is_what_it_is():
    told = figure(Contest("a record of 10 s", "real time", burnt(1000), 1.0, (10.0, 1.0), goal=1e9, once=True), 3)
    assert told.theirs == 1.0
    assert told.ratio == pytest.approx(1.0 / told.ours, rel=0.9)
    assert not told.met


def test_the_table_says_what_is_not_met():
    met, missed = (Figure(name, "ref", 2e-6, 8e-6, 4.0, 3.5, goal) for name, goal in (("a", 3.0), ("b", 5.0)))
    lines = bench_speed.table([met, missed]).splitlines()
    assert lines[1].split() == ["a", "2", "µs", "ref", "8", "µs", "4.00", "3.50", "3"]
    assert lines[2].endswith("5 not met")
    marked = bench_speed.markdown([met])
    assert marked.splitlines()[-1] == "| a | 2 µs | ref | 8 µs | 4.00 | 3.50 | 3 |"


@pytest.mark.parametrize(("value", "told"), [(2.5, "2.5 s"), (0.031, "31 ms"), (4.2e-6, "4.2 µs"), (3e-10, "0.3 ns")])
def test_times_have_the_unit_they_are_best_read_in(value, told):
    assert bench_speed.time_of(value) == told
