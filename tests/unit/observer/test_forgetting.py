"""When a filter bank forgets, and how much: a power of its readings' age, one block at a time."""

import numpy as np
import pytest

from palmd.observer.bank import Belief
from palmd.observer.forgetting import AT_LEAST_EVERY_S, EVERY_S, FIRST_AGE_S, HIGH_NIS, STRENGTH, Forgetting


class Blocks:
    """Two blocks of two filters, which record the requested forgetting."""

    blocks, size = 2, 4

    def __init__(self, nis=1.0):
        self.nis = np.full(4, nis)
        self.faded = []

    def best(self):
        return 0

    def members(self, block):
        return slice(2 * block, 2 * block + 2)

    def fade(self, block, fraction, _prior):
        self.faded.append((block, fraction))


BELIEF = Belief(slice(0, 1), np.zeros((4, 1)), np.ones(1))


def step(forgetting, bank, t):
    """Let the block that is due forget; its number."""
    block = forgetting.due(bank, t, t)
    if block is not None:
        forgetting.forget(bank, block, t, t, 1.0, BELIEF)
    return block


def started(nis=1.0, prior_age=(0, 0, 0, 0), everywhere=True):
    bank = Blocks(nis)
    forgetting = Forgetting(bank)
    forgetting.prior_age_s[:] = prior_age
    forgetting.begin(0.0, everywhere)
    return bank, forgetting


def test_blocks_take_turns_when_they_are_due():
    bank, forgetting = started()
    assert step(forgetting, bank, 0.9 * EVERY_S) is None
    assert [step(forgetting, bank, t) for t in (0.21, 0.22, 0.23)] == [0, 1, None]
    assert [block for block, _ in bank.faded] == [0, 1]


def test_old_readings_fade_less():
    bank, forgetting = started()
    step(forgetting, bank, 0.25)
    assert bank.faded[0][1] == pytest.approx(STRENGTH * 0.25 / (FIRST_AGE_S + 0.25))
    forgetting.t_faded[:] = 3.0
    assert [step(forgetting, bank, t) for t in (3.29, 3.35)] == [None, 0], "intervals of a tenth of the age"
    forgetting.t_faded[:] = 10.0
    assert step(forgetting, bank, 10.0 + 0.9 * AT_LEAST_EVERY_S) is None
    step(forgetting, bank, 10.5)
    assert bank.faded[-1][1] == pytest.approx(STRENGTH * 0.5 / (FIRST_AGE_S + 10.5))


def test_prior_knowledge_fades_like_older_readings():
    bank, forgetting = started(prior_age=(4.0, 5.0, 0.0, 4.0))
    step(forgetting, bank, 0.25)
    step(forgetting, bank, 0.25)
    known, blind = (fraction for _, fraction in bank.faded)
    assert known == pytest.approx(STRENGTH * 0.25 / (FIRST_AGE_S + 4.25))
    assert blind > 5 * known


def test_a_high_nis_makes_it_forget_faster_up_to_everything():
    calm, high_nis = started(nis=HIGH_NIS), started(nis=HIGH_NIS + 0.05)
    for bank, forgetting in (calm, high_nis):
        step(forgetting, bank, 1.0)
    assert calm[0].faded[0][1] == 1.0 == high_nis[0].faded[0][1]
    for bank, forgetting in (calm, high_nis):
        forgetting.t_faded[:] = 9.5
        step(forgetting, bank, 10.0)
    assert high_nis[0].faded[1][1] == pytest.approx(2.0 * calm[0].faded[1][1])


def test_filters_confirmed_by_a_smoother_do_not_forget():
    bank, forgetting = started(prior_age=(4.0, 4.0, 4.0, 0.0), everywhere=False)
    assert [step(forgetting, bank, 1.0) for _ in range(3)] == [1, None, None]
    assert step(Forgetting(bank), bank, 1e9) is None, "nothing is due before it begins"
