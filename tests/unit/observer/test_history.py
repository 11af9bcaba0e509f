"""Undoing events for a late one: back to the bank's earlier state, as far as memory allows."""

import numpy as np
import pytest

from palmd.events import PadSample
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.history import EVENTS, Fused, History
from palmd.system.description import RigDescription


@pytest.fixture(scope="module")
def bank():
    return ShapeFilters(RigDescription(), 8).bank


def history_of_events(bank, count):
    """A history of events at 1, 2, … s; before each event all states equal its number."""
    history = History([bank])
    history.use(bank)
    bank.refill()
    for t in range(1, count + 1):
        bank.x[:] = t
        before = history.snapshot()
        bank.remember(before)
        history.add(Fused(float(t), PadSample(float(t), 1, 0.02), t - 1.0, np.zeros(1), before))
    bank.x[:] = np.nan
    return history


def test_later_events_are_undone_and_returned_in_order(bank):
    undone = history_of_events(bank, 5).undo(2.5, bank)
    assert [entry.event.t_sample for entry in undone] == [3.0, 4.0, 5.0]
    assert np.all(bank.x == 3.0)


def test_an_undone_event_is_gone(bank):
    history = history_of_events(bank, 5)
    history.undo(2.5, bank)
    assert history.undo(4.5, bank) is None


def test_the_number_of_events_that_can_be_undone_is_limited(bank):
    history = history_of_events(bank, EVENTS + 3)
    assert history.undo(2.5, bank) is None
    assert np.all(np.isnan(bank.x)), "a too late event changes nothing"
    assert len(history.undo(3.5, bank)) == EVENTS


def test_a_cleared_history_cannot_be_undone(bank):
    history = history_of_events(bank, 5)
    history.clear()
    assert history.undo(2.5, bank) is None
    assert len({id(history.snapshot()) for _ in range(EVENTS)}) == EVENTS, "all snapshots are reusable"
