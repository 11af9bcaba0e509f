"""When a bank forgets, and how much: as a power of its readings' age, one block at a time."""

import numpy as np
import pytest

from palmd.observer.bank import Belief
from palmd.observer.forgetting import AT_LEAST_EVERY_S, EVERY_S, FIRST_AGE_S, HIGH_NIS, STRENGTH, Forgetting


class Blocks:
    """Two blocks of two filters, which note what they are told to forget."""

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


def belief():
    return Belief(slice(0, 1), np.zeros((4, 1)), np.ones(1))


def begun(nis=1.0, prior_age=(0, 0, 0, 0), everywhere=True):
    bank = Blocks(nis)
    forgetting = Forgetting(bank)
    forgetting.prior_age_s[:] = prior_age
    forgetting.begin(0.0, everywhere)
    return bank, forgetting


def test_blocks_take_turns_when_they_are_due():
    bank, forgetting = begun()
    assert forgetting.step(bank, 0.9 * EVERY_S, 0.9 * EVERY_S, 1.0, belief) is None
    assert [forgetting.step(bank, t, t, 1.0, belief) for t in (0.21, 0.22, 0.23)] == [0, 1, None]
    assert [block for block, _ in bank.faded] == [0, 1]


def test_old_readings_fade_by_less():
    bank, forgetting = begun()
    forgetting.step(bank, 0.25, 0.25, 1.0, belief)
    assert bank.faded[0][1] == pytest.approx(STRENGTH * 0.25 / (FIRST_AGE_S + 0.25))
    forgetting.t_faded[:] = 3.0
    assert [forgetting.step(bank, t, t, 1.0, belief) for t in (3.29, 3.35)] == [None, 0], "a tenth of the age apart"
    forgetting.t_faded[:] = 10.0
    assert forgetting.step(bank, 10.0 + 0.9 * AT_LEAST_EVERY_S, 10.0, 1.0, belief) is None
    forgetting.step(bank, 10.5, 10.5, 1.0, belief)
    assert bank.faded[-1][1] == pytest.approx(STRENGTH * 0.5 / (FIRST_AGE_S + 10.5))


def test_what_was_known_before_fades_as_if_it_were_older():
    bank, forgetting = begun(prior_age=(4.0, 5.0, 0.0, 4.0))
    forgetting.step(bank, 0.25, 0.25, 1.0, belief)
    forgetting.step(bank, 0.25, 0.25, 1.0, belief)
    known, blind = (fraction for _, fraction in bank.faded)
    assert known == pytest.approx(STRENGTH * 0.25 / (FIRST_AGE_S + 4.25))
    assert blind > 5 * known


def test_surprise_makes_it_forget_faster_but_never_more_than_all():
    calm, surprised = begun(nis=HIGH_NIS), begun(nis=HIGH_NIS + 0.05)
    for bank, forgetting in (calm, surprised):
        forgetting.step(bank, 1.0, 1.0, 1.0, belief)
    assert calm[0].faded[0][1] == 1.0 == surprised[0].faded[0][1]
    for bank, forgetting in (calm, surprised):
        forgetting.t_faded[:] = 9.5
        forgetting.step(bank, 10.0, 10.0, 1.0, belief)
    assert surprised[0].faded[1][1] == pytest.approx(2.0 * calm[0].faded[1][1])


def test_what_a_smoother_vouches_for_does_not_forget():
    bank, forgetting = begun(prior_age=(4.0, 4.0, 4.0, 0.0), everywhere=False)
    assert [forgetting.step(bank, 1.0, 1.0, 1.0, belief) for _ in range(3)] == [1, None, None]
    assert Forgetting(bank).step(bank, 1e9, 1e9, 1.0, belief) is None, "not begun, not due"
