"""The search for an unknown object: when its result is accepted."""

import math
from dataclasses import replace

import pytest
from simulated import simulated

from palmd.events import PadSample, PalmSample
from palmd.model.shape_map import Z
from palmd.observer import initialiser
from palmd.observer.data_segment import data_segments, longest_segment
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.initialiser import Initialiser
from palmd.observer.search import MOTIONS, Attempt, Likeliest, Search, explained
from palmd.observer.smoothing import Session
from palmd.system.description import AS_CALIBRATED
from palmd.system.vibration import INDEPENDENT

RUN = ("friction", 107, 3.0)
STARVED_S = 0.8


def confirmations(rig, times=2):
    """Whether the result for the same readings is confirmed, for each of so many calls."""
    (segment,) = data_segments(simulated(*RUN).events)
    mine = Initialiser(rig, 0)
    return [mine.search(segment, None) is not None and mine.confirmed for _ in range(times)]


@pytest.fixture
def rig():
    return simulated(*RUN).rig


def test_on_an_exactly_known_rig_the_first_search_is_accepted(rig):
    assert confirmations(rig, 1) == [True]


def test_on_an_exact_rig_a_result_must_be_likelier_than_the_fixed_mode(rig, monkeypatch):
    monkeypatch.setattr(Search, "likeliest", lambda _, finding, motions: Likeliest(finding, False, motions))
    assert confirmations(rig) == [False, False]


def test_the_fixed_mode_is_not_retested_on_an_extension_of_the_same_record(rig, monkeypatch):
    """It is retested if the record begins later or if the rig's prior changes."""
    tried = []

    def likeliest(_, finding, motions):
        tried.append(motions)
        return Likeliest(finding, False, motions[1:])

    monkeypatch.setattr(Search, "likeliest", likeliest)
    whole = longest_segment(simulated(*RUN).events)
    seek = Initialiser(rig, seed=0)
    for segment in (whole.until(whole.start + 2.0), whole, whole.since(whole.start + 1.0), whole):
        seek.search(segment, None)
    assert tried == [MOTIONS, MOTIONS[1:], MOTIONS, MOTIONS]
    search = Search(whole, rig)
    seek._likeliest(search, None)
    seek._likeliest(search.with_belief(search.belief.suspended()), None)
    assert tried[-1] == MOTIONS


def test_with_uncertain_constants_a_second_search_must_agree(rig, monkeypatch):
    """Outlines that are wrong by a millimetre explain short records as well."""
    calibrated = rig.known_to({**AS_CALIBRATED, "friction_sd": 0.0})
    assert confirmations(calibrated) == [False, True]
    monkeypatch.setattr(initialiser, "agree", lambda *_: False)
    assert confirmations(calibrated, 3) == [False] * 3


@pytest.mark.parametrize(("alone_s", "sure"), [(2.0, True), (4.0, False)])
def test_a_result_without_rivals_on_a_long_record_needs_no_second_search(rig, monkeypatch, alone_s, sure):
    """In long records blind searches often fail, so that a correct result could never be confirmed."""
    calibrated, blind, begun = rig.known_to({**AS_CALIBRATED, "friction_sd": 0.0}), Search.blind, []

    def once(self, attempt, seed):
        begun.append(attempt)
        return blind(self, attempt, seed) if len(begun) == 1 else None

    monkeypatch.setattr(Search, "blind", once)
    monkeypatch.setattr(initialiser, "ALONE_S", alone_s)
    assert confirmations(calibrated) == [False, sure]


def test_on_a_fixed_hinge_it_is_compared_with_unequal_friction_of_both_signs(rig, monkeypatch):
    """For seconds, unequal friction and equal friction with a wrong outline explain the readings equally well."""
    begun, blind = [], Search.blind

    def noted(self, attempt, seed):
        begun.append(attempt.asymmetry)
        return blind(self, attempt._replace(asymmetry=0.0), seed)

    monkeypatch.setattr(Search, "blind", noted)
    assert rig.hinge == "fixed"
    assert confirmations(rig.known_to(AS_CALIBRATED), 3) == [False, False, True]
    assert begun[0] == 0.0
    assert {*begun[1:]} == {0.5, -0.5}


def test_failed_searches_of_a_long_record_show_that_there_is_no_rival(rig, monkeypatch):
    """In a short record they do not: the only outline found may be wrong."""
    blind = Search.blind
    monkeypatch.setattr(
        Search, "blind", lambda self, attempt, seed: None if attempt.asymmetry else blind(self, attempt, seed)
    )
    assert confirmations(rig.known_to(AS_CALIBRATED), 4) == [False] * 4
    monkeypatch.setattr(initialiser, "SUFFICIENT_S", 2.0)
    assert confirmations(rig.known_to(AS_CALIBRATED), 4) == [False, False, True, True]


def test_corrupted_early_readings_are_dropped_when_nothing_explains_them():
    """Otherwise nothing would be found until the record is too long to be kept."""
    run = simulated("friction", 107, 5.0)
    events = []
    for event in run.events:
        t = event.t_sample
        if isinstance(event, PalmSample) and STARVED_S - 0.09 < t < STARVED_S:
            continue
        if isinstance(event, PadSample) and t < STARVED_S:
            event = replace(event, s=event.s + 2e-3 * math.sin(40.0 * t))
        events.append(event)
    smoother = IncrementalSmoother(run.rig)
    smoother.add(Session(1, events[0].t_sample), events)
    assert smoother.answer() is None
    found = smoother.answer()
    assert found is not None
    assert math.exp(found.x[Z.LN_RHO]) == pytest.approx(run.truth.rho, rel=0.1)
    assert found.x[Z.SHAPE] == pytest.approx(run.truth.h.mean(), abs=1e-4)


@pytest.fixture
def asked(monkeypatch):
    """The searches in the order of their calls; `nothing` lists those that return nothing."""
    order, nothing = [], set()
    for name in ("from_constants", "blind"):
        search = getattr(Search, name)

        def noted(self, *arguments, name=name, search=search):
            order.append(name)
            return None if name in nothing else search(self, *arguments)

        monkeypatch.setattr(Search, name, noted)
    return order, nothing


def test_a_confirmed_result_found_again_without_rivals_is_not_challenged(rig, asked):
    order, _ = asked
    whole = longest_segment(simulated("friction", 107, 6.5).events)
    seek = Initialiser(rig, 0)
    for seconds, searches in ((1.5, 1), (2.9, 1), (3.1, 2), (6.3, 2)):
        assert seek.search(whole.until(whole.start + seconds), None) is not None
        assert seek.confirmed
        assert len(order) == searches


def disagree(monkeypatch):
    monkeypatch.setattr(initialiser, "agree", lambda *_: False)


def find_a_rival(monkeypatch):
    merged = Search.merged

    def doubled(self, one, other):
        best = merged(self, one, other)
        return replace(best, fits=(best.fits[0], best.fits[0]))

    monkeypatch.setattr(Search, "merged", doubled)
    monkeypatch.setattr(Search, "likeliest", lambda _, finding, motions: Likeliest(finding, True, motions))


@pytest.mark.parametrize("come_out", [disagree, find_a_rival])
def test_a_confirmed_result_with_rivals_is_challenged_when_the_record_has_doubled(rig, asked, monkeypatch, come_out):
    order, _ = asked
    come_out(monkeypatch)
    whole = longest_segment(simulated("friction", 107, 6.5).events)
    seek = Initialiser(rig, 0)
    for seconds, searches in ((1.5, 1), (3.1, 2), (6.3, 3)):
        seek.search(whole.until(whole.start + seconds), None)
        assert seek.confirmed
        assert len(order) == searches


@pytest.mark.parametrize(
    ("nothing", "exact", "expected"),
    [((), True, ["blind"]), (("blind",), True, ["blind", "from_constants"]), ((), False, ["from_constants", "blind"])],
)
def test_a_filters_converged_state_is_a_second_start_with_uncertain_constants(rig, asked, nothing, exact, expected):
    """On an exactly known rig it is the start when the blind search finds nothing."""
    order, vain = asked
    vain.update(nothing)
    segment = longest_segment(simulated(*RUN).events)
    hint = Search(segment, rig).prior.mean
    rig = rig if exact else rig.known_to({**AS_CALIBRATED, "friction_sd": 0.0})
    Initialiser(rig, 0).search(segment, hint)
    assert order == expected


def test_a_filters_converged_state_is_not_used_once_a_result_is_known(rig, asked):
    order, vain = asked
    whole = longest_segment(simulated("friction", 107, 3.2).events)
    seek = Initialiser(rig, 0)
    assert seek.search(whole.until(whole.start + 1.5), None) is not None
    vain.add("blind")
    seek.search(whole.until(whole.start + 3.1), Search(whole, rig).prior.mean)
    assert order == ["blind", "blind"]


def test_after_two_failed_searches_it_restarts_with_the_latest_readings(rig, monkeypatch):
    """Unexplainable readings would be at the beginning of every longer record."""
    monkeypatch.setattr(Search, "blind", lambda *_: None)
    whole = longest_segment(simulated("friction", 0, 8.0).events)
    seek, useful = Initialiser(rig, seed=0), []
    for seconds in (3.0, 3.7, 5.0):
        assert seek.search(whole.until(whole.start + seconds), None) is None
        useful.append(seek.needs_from - whole.start)
    assert useful[:1] == [-math.inf]
    assert useful[1] == useful[2] == pytest.approx(3.7 - initialiser.RENEWED_S, abs=0.02)


def test_a_fit_that_does_not_converge_is_retried_with_the_friction_discrepancy(rig):
    """With stick and slip, the iteration may cycle at the corners of the friction law."""
    run = simulated("friction", 700, 4.0, vibration=INDEPENDENT)
    search = Search(longest_segment(run.events), run.rig)
    found = search.blind(Attempt(2.0, 3), 0)
    assert found is not None
    unsettled = replace(found, fits=(replace(found.fits[0], settled=False),))
    doubted = search.with_friction_discrepancy(unsettled)
    assert doubted.fits[0].settled
    assert doubted.record.discrepancy.any()
    assert explained(doubted.fits[0], doubted.record)
    old = simulated("friction", 0, 4.0)  # by the averaged law, which has no discrepancy
    search = Search(longest_segment(old.events), old.rig)
    found = search.blind(Attempt(2.0, 3), 0)
    unsettled = replace(found, fits=(replace(found.fits[0], settled=False),))
    assert search.with_friction_discrepancy(unsettled) is unsettled


def test_readings_that_a_hypothesis_cannot_be_extended_to_are_explained_by_a_rival(rig, monkeypatch):
    whole = longest_segment(simulated("friction", 107, 10.0).events)
    seek = Initialiser(rig, 0)
    assert seek.search(whole.until(whole.start + 1.5), None) is not None
    monkeypatch.setattr(Search, "resumed", lambda *_: None)
    solution = seek.search(whole.until(whole.start + 2.5), None)
    assert solution is not None
    assert solution.lasts > 2.4


def test_one_unexplained_step_does_not_reject_a_confirmed_hypothesis(rig, asked, monkeypatch):
    order, _ = asked
    whole = longest_segment(simulated("friction", 107, 10.0).events)
    seek, resumed = Initialiser(rig, 0), Search.resumed
    assert seek.search(whole.until(whole.start + 1.5), None) is not None
    assert seek.confirmed
    with monkeypatch.context() as hard:
        hard.setattr(Search, "resumed", lambda *_: None)
        hard.setattr(Search, "rival", lambda *_: None)
        assert seek.search(whole.until(whole.start + 2.5), None) is None
        assert not seek.unexplained
        assert order == ["blind"]
    monkeypatch.setattr(Search, "resumed", resumed)
    assert seek.search(whole.until(whole.start + 2.8), None) is not None
    assert order == ["blind"]
    monkeypatch.setattr(Search, "resumed", lambda *_: None)
    monkeypatch.setattr(Search, "rival", lambda *_: None)
    seek.search(whole, None)
    assert len(order) > 1  # after `LOST_S` a new search is started
