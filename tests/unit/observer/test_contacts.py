"""Contact states from the pads' readings."""

import math

import pytest

from palmd.events import PadSample, PalmSample
from palmd.observer.contacts import GONE_S, SILENCE_S, Contacts, finite


def read(*samples):
    contacts = Contacts()
    for t, pad in samples:
        contacts.read(PadSample(t, pad, 0.02))
    return contacts


def test_contact_requires_recent_readings_of_both_pads():
    assert not read((1.0, 1)).touching(1.0)
    both = read((1.0, 1), (1.05, 2))
    assert both.touching(1.0 + 0.9 * SILENCE_S)
    assert not both.touching(1.0 + 1.1 * SILENCE_S)
    assert both.least_recent == 1.0


def test_before_the_first_reading_all_times_are_minus_infinity():
    contacts = Contacts()
    assert contacts.least_recent == contacts.resumed == contacts.last_seen(2) == -math.inf
    assert contacts.last(1) is None
    assert not contacts.any


def test_clearing_forgets_all_readings():
    contacts = read((1.0, 1), (1.0, 2))
    contacts.clear()
    assert contacts.least_recent == contacts.last_seen(1) == -math.inf
    assert contacts.gone(1.0)
    contacts.read(PadSample(1.01, 1, 0.02))
    assert contacts.least_recent == -math.inf
    assert not contacts.touching(1.01)
    assert contacts.last(2) is None
    contacts.read(PadSample(1.01, 2, 0.02))
    assert contacts.touching(1.01)


def test_a_lifted_pad_is_in_contact_again_after_a_reading():
    contacts = read((1.0, 1), (1.0, 2))
    contacts.lift(2)
    assert not contacts.touching(1.01)
    assert contacts.read_lately(1.01)
    contacts.read(PadSample(1.02, 2, 0.02))
    assert contacts.touching(1.02)


def test_an_older_reading_changes_nothing():
    contacts = read((1.0, 1), (1.0, 2))
    contacts.lift(1)
    contacts.read(PadSample(0.99, 1, 0.03))
    assert contacts.last(1).t_sample == 1.0
    assert not contacts.touching(1.0)


def test_resumed_is_the_time_since_which_a_pad_is_read_again():
    contacts = read((1.0, 1), (1.0, 2), (1.05, 1))
    assert contacts.resumed == 1.0
    contacts.read(PadSample(1.05 + 1.1 * SILENCE_S, 1, 0.02))
    assert contacts.resumed == pytest.approx(1.05 + 1.1 * SILENCE_S)


def test_an_object_is_gone_after_long_silence_or_lifts_of_both_pads():
    contacts = read((1.0, 1), (1.02, 2))
    assert not contacts.gone(1.0 + 0.9 * GONE_S)
    assert contacts.gone(1.0 + 1.1 * GONE_S)
    contacts.lift(1)
    assert not contacts.gone(1.02 + 1.1 * SILENCE_S)  # it may lie on the other pad
    contacts.lift(2)
    assert not contacts.gone(1.02 + 0.9 * SILENCE_S)
    assert contacts.gone(1.02 + 1.1 * SILENCE_S)
    contacts.read(PadSample(1.02 + 1.2 * SILENCE_S, 2, 0.02))
    assert not contacts.gone(1.02 + 1.3 * SILENCE_S)
    assert Contacts().gone(0.0)


def test_read_about_accepts_slightly_later_readings():
    contacts = read((1.05, 1), (1.0, 2))
    assert contacts.read_about(1.0)
    assert not contacts.read_about(1.05 - 1.1 * SILENCE_S)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_one_non_finite_number_makes_an_event_invalid(bad):
    assert finite(PadSample(1.0, 1, 0.02))
    assert finite(PalmSample(1.0, (0.8, 1.6)))
    assert not finite(PadSample(bad, 1, 0.02))
    assert not finite(PadSample(1.0, 1, 0.02, bad))
    assert not finite(PalmSample(1.0, (0.8, bad)))
    assert not finite(PalmSample(1.0, (0.8, 1.6), (bad, 0.0)))
