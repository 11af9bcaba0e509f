"""A chain of marginalised segments has the information of the whole record."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import simulated

from palmd.model.smoothing import CONSTANTS, C, R
from palmd.observer import chain as chain_module
from palmd.observer.chain import Chain
from palmd.observer.data_segment import longest_segment
from palmd.observer.normal_equations import Guess, NormalEquations
from palmd.observer.search import NOISE, Attempt, Search, explained
from palmd.observer.smoother import Smoother
from palmd.system.description import RigDescription

STEPS = 100  # 1 s
DRAWS = 20


@pytest.fixture(scope="module")
def smoothed():
    """A search and its result on six seconds."""
    run = simulated("friction", 7, 6.0)
    search = Search(longest_segment(run.events), run.rig)
    finding = search.blind(Attempt(2.0, 3), seed=0)
    assert finding is not None
    assert len(finding.record.t) == len(search.record.t)
    return search, finding


def cut(smoothed, kept=60, at=None):
    """The chain of the record's segments, linearised at the result for the whole record or at other constants."""
    search, finding = smoothed
    record, guess = finding.record, finding.fits[0].guess
    chain = Chain(search.library, NOISE, search.prior, kept)
    for first in range(0, len(record.dt), STEPS):
        last = min(first + STEPS, len(record.dt))
        chain.append(record.between(first, last), Guess(guess.x[first : last + 1], guess.p if at is None else at))
    return chain


@pytest.mark.parametrize("kept", [60, 2], ids=["kept", "marginalised"])
def test_a_chain_has_the_information_of_the_whole_record(smoothed, kept):
    search, finding = smoothed
    best = finding.fits[0]
    whole = Smoother(search.library, finding.record, search.prior).posterior(best).covariance
    known = cut(smoothed, kept).known(best.guess.p)
    sd = np.sqrt(np.diagonal(whole))
    covariance = np.linalg.inv(known.matrix)
    assert covariance / np.outer(sd, sd) == pytest.approx(whole / np.outer(sd, sd), abs=1e-4)
    assert known.cost == pytest.approx(best.cost, rel=1e-6)
    assert known.excess() < 0.1  # at its minimum, within the iteration's tolerance


def test_the_information_without_the_prior_is_the_difference(smoothed):
    chain, p = cut(smoothed), smoothed[1].fits[0].guess.p
    information, prior = chain.information(p), chain.prior(p)
    known = chain.known(p).marginalised(slice(CONSTANTS, None))
    assert information.plus(prior).matrix == pytest.approx(known.matrix)
    assert information.matrix[C.DAMPING, C.DAMPING] < known.matrix[C.DAMPING, C.DAMPING]


def test_further_knowledge_adds_to_the_information(smoothed):
    p = smoothed[1].fits[0].guess.p
    for kept in (60, 2):
        chain, twice = cut(smoothed, kept), cut(smoothed, kept)
        twice.learn(chain.information(p))
        gained = twice.known(p).matrix[:CONSTANTS, :CONSTANTS] - chain.known(p).matrix[:CONSTANTS, :CONSTANTS]
        assert gained == pytest.approx(chain.information(p).matrix, rel=1e-6, abs=1e-6 * np.abs(gained).max())


def test_relinearisation_corrects_a_chain_linearised_elsewhere(smoothed, monkeypatch):
    finding = smoothed[1]
    guess = finding.fits[0].guess
    off = guess.p.copy()
    off[C.SHAPE] += 3e-4
    off[C.DRAG] += 4.0
    wanted = cut(smoothed).known(guess.p)
    chain = cut(smoothed, at=off)
    sd = np.sqrt(np.diagonal(np.linalg.inv(wanted.matrix)))
    before = chain.known(guess.p)
    monkeypatch.setattr(chain_module, "NEAR", 1e-3)
    assert chain.renew(guess.p, guess.x[-1]) > 0
    for _ in range(4):
        chain.renew(guess.p, guess.x[-1])
    after = chain.known(guess.p)
    errors = [np.abs(np.linalg.solve(known.matrix, known.side) / sd).max() for known in (before, after)]
    assert errors[1] < 0.5
    assert errors[0] > 2 * errors[1]
    covariances = [np.linalg.inv(known.matrix) / np.outer(sd, sd) for known in (after, wanted)]
    assert covariances[0] == pytest.approx(covariances[1], abs=0.05)


def test_a_segment_that_cannot_be_relinearised_is_unchanged(smoothed, monkeypatch):
    p = smoothed[1].fits[0].guess.p.copy()
    p[C.SHAPE] += 3e-4
    chain = cut(smoothed)
    before = chain.known(p)

    def unsolvable(*_):
        raise np.linalg.LinAlgError("not positive definite")

    monkeypatch.setattr(NormalEquations, "inner_step", unsolvable)
    assert not chain.renew(p, before.about[CONSTANTS:])
    assert chain.known(p).matrix == pytest.approx(before.matrix)


@pytest.mark.parametrize("times", [0.3, 1.5, 5.0])
def test_constants_that_were_wrong_for_a_moment_leave_nothing_behind(smoothed, times):
    """With other friction the motion of most segments is not found; what the iteration ends in is no linearisation."""
    guess = smoothed[1].fits[0].guess
    wrong = guess.p.copy()
    wrong[C.DRAG] *= times
    chain = cut(smoothed)
    before = chain.known(guess.p)
    for p in (wrong, wrong, guess.p, guess.p):
        chain.renew(p, guess.x[-1])
    after = chain.known(guess.p)
    sd = np.sqrt(np.diagonal(np.linalg.inv(before.matrix)))
    assert np.abs(after.solved(after.side) / sd).max() < 0.5
    assert np.sqrt(np.diagonal(np.linalg.inv(after.matrix))) == pytest.approx(sd, rel=0.1)


def test_an_hour_needs_no_more_memory_than_two_minutes(smoothed):
    search, finding = smoothed
    chain, guess = Chain(search.library, NOISE, search.prior, kept=5), finding.fits[0].guess
    piece = finding.record.between(0, STEPS)
    for _ in range(50):
        chain.append(piece, Guess(guess.x[: STEPS + 1], guess.p))
    assert len(chain._segments) == 5


@pytest.mark.parametrize("kept", [60, 2], ids=["kept", "marginalised"])
def test_changing_the_rigs_prior_equals_using_it_from_the_beginning(smoothed, kept):
    search, finding = smoothed
    p = finding.fits[0].guess.p
    doubting = Search(
        longest_segment(simulated("friction", 7, 6.0).events), RigDescription(), belief=search.belief.suspended()
    )
    late, early = cut(smoothed, kept), cut((doubting, finding), kept)
    late.revise(search.belief.sd, doubting.belief.sd)
    scale = np.sqrt(np.diagonal(early.known(p).matrix))
    for of in (Chain.known, Chain.information, Chain.prior):
        one, other = of(late, p).matrix, of(early, p).matrix
        of_these = np.outer(scale, scale)[: len(one), : len(one)]
        assert one / of_these == pytest.approx(other / of_these, abs=1e-5)


def test_a_constant_with_a_widened_prior_follows_the_readings(smoothed):
    """Damped by its previous tiny one-sigma, it would not move."""
    search, finding = smoothed
    record, best = finding.record, finding.fits[0].guess
    chain = Chain(search.library, NOISE, search.prior)
    chain.append(record.between(0, 500), Guess(best.x[:501], best.p))
    opened = search.belief.sd.copy()
    opened[R.TURN] = np.radians(1.0)
    chain.revise(search.belief.sd, opened)
    later = Smoother(search.library, record.between(500, len(record.dt)), chain.known(best.p))
    p, turn = best.p.copy(), C.RIG + R.TURN
    p[turn] += np.radians(1.0)
    fit = later.fit(Guess(best.x[500:], p), NOISE)
    posterior = later.posterior(fit)
    assert fit.settled
    sd = np.sqrt(posterior.covariance[turn, turn])
    assert sd < np.radians(0.4), "the readings determine it"
    assert fit.guess.p[turn] == pytest.approx(posterior.constants[turn], abs=0.2 * sd)


def test_a_chain_converges_to_its_readings_after_a_change_of_the_prior(smoothed):
    """From wrong constants: everything is relinearised on the way."""
    p = smoothed[1].fits[0].guess.p
    covariance = np.linalg.inv(cut(smoothed).known(p).matrix)[:CONSTANTS, :CONSTANTS]
    sd = np.sqrt(np.diagonal(covariance))
    wrong = p + 80.0 * covariance[:, C.SHAPE + 2] / sd[C.SHAPE + 2]
    chain = cut(smoothed, at=wrong)
    once = chain.known(wrong)
    stepped = wrong + once.solved(once.side)[:CONSTANTS]
    assert (np.abs(chain.settle(wrong) - p) / sd).max() < 0.2 < (np.abs(stepped - p) / sd).max()


def unexplained(smoothed, sigmas):
    """Whether later readings are unexplained, for random errors of what the first ones determine, so many σ large."""
    search, finding = smoothed
    record, guess = finding.record, finding.fits[0].guess
    chain, half = Chain(search.library, NOISE, search.prior), 3 * STEPS
    chain.append(record.between(0, half), Guess(guess.x[: half + 1], guess.p))
    known, rest = chain.known(guess.p), record.between(half, len(record.dt))
    root, random = np.linalg.inv(np.linalg.cholesky(known.matrix)).T, np.random.default_rng(5)
    found = list[bool]()
    for _ in range(DRAWS):
        wrong = replace(known, about=known.about + sigmas * root @ random.standard_normal(len(known.about)))
        fit = Smoother(search.library, rest, wrong).fit(Guess(guess.x[half:], guess.p), search.noise)
        found.append(not explained(fit, rest))
    return np.array(found)


def test_readings_contradict_constants_that_earlier_readings_exclude(smoothed):
    assert unexplained(smoothed, 1.0).sum() <= 1  # the error that is expected
    assert unexplained(smoothed, 3.0).mean() > 0.9
