"""A search that begins later in a record ends at the same minimum or gives no result."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.observer.backward_extension import extended_backwards, knowledge_of_constants
from palmd.observer.data_segment import longest_segment
from palmd.observer.reconstruct import reconstruct
from palmd.observer.search import Attempt, Search, explained
from palmd.observer.smoother import Smoother
from tools.studies import sbc
from tools.studies.simulated import simulated as calibrated_run

LATER = Attempt(2.0, 3, later_s=0.7)


@pytest.fixture(scope="module")
def search():
    """A search in readings that are easy to explain."""
    run = simulated("friction", 7, 6.0)
    return Search(longest_segment(run.events), run.rig)


@pytest.fixture(scope="module")
def found(search):
    """The result of a search from the beginning of the record."""
    return search.blind(Attempt(2.0, 3), seed=0)


def test_a_search_that_begins_later_finds_the_same_minimum(search, found):
    later = search.blind(LATER, seed=0)
    assert later is not None
    assert len(later.record.t) == len(found.record.t)
    one, other = later.fits[0], found.fits[0]
    assert one.cost == pytest.approx(other.cost, abs=0.1)
    sd = np.sqrt(np.diagonal(Smoother(search.library, found.record, search.known).posterior(other).covariance))
    assert (np.abs(one.guess.p - other.guess.p) < 0.2 * sd[: len(other.guess.p)]).all()
    assert one.guess.x[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_earlier_readings_of_another_motion_are_not_joined(search, found):
    best, cut, record = found.fits[0], 150, search.record
    covariance = Smoother(search.library, found.record, search.known).posterior(best).covariance
    known = knowledge_of_constants(best.guess.p, covariance, search.prior.scale)
    off = np.where(record.contact_step < 40, 4e-3, 0.0)
    other = replace(record, contact_value=record.contact_value + off)
    fit = replace(best, guess=replace(best.guess, x=best.guess.x[cut:]))
    assert extended_backwards(search.library, other, fit, known, explained) is None


@pytest.mark.parametrize("limit", [{"later_s": 4.5}, {"work": 10.0}], ids=["too short a record", "too little work"])
def test_a_search_ends_at_its_limits(search, limit):
    assert search.blind(Attempt(2.0, 3, **limit), seed=0) is None


def test_a_hard_beginning_does_not_start_the_search_for_other_kinds_of_object(monkeypatch):
    """The search from the first reading finds nothing. It was once tried only after sticking objects and flat sides."""

    def asked(*_):
        pytest.fail("searched for another kind of object")

    monkeypatch.setattr("palmd.observer.reconstruct.dry_reconstruction", asked)
    body, surface = sbc.drawn_from_prior("odd", 64002)
    log, truth = calibrated_run("odd", 64002, 10.0, body, "calibrated", surface)
    answer = reconstruct(log.events, log.rig)
    assert answer.converged, answer.reason
    assert answer.t[-1] - answer.t[0] > 9.9
    assert sbc.row_of(sbc.SbcTask("odd", 64002, 10.0), truth, answer).worst_z < 3.0


def test_a_record_too_short_for_a_later_start_gets_a_second_search():
    body, surface = sbc.drawn_from_prior("nominal", 67007)
    log, _ = calibrated_run("nominal", 67007, 10.0, body, "calibrated", surface)
    begin = log.events[0].t_sample
    answer = reconstruct([event for event in log.events if event.t_sample < begin + 1.6], log.rig)
    assert answer.converged
    assert not answer.contradicted.any()  # the first search finds an outline off by 1 mm, and a rig that fits it
