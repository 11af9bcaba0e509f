"""No external data break a reader: the stored bytes, and random ones near them."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from targets import TARGETS

KEPT = Path(__file__).parent / "corpus"
EXAMPLES = 60


def kept(name):
    return [path.read_bytes() for path in sorted((KEPT / name).iterdir())]


@st.composite
def damaged(draw, seeds):
    """A stored file with pieces removed, overwritten or inserted, or unrelated bytes."""
    data = bytearray(draw(st.one_of(st.sampled_from(seeds), st.binary(max_size=200))))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data)))
        taken = draw(st.integers(0, 12))
        data[at : at + taken] = draw(st.binary(max_size=12))
    return bytes(data)


def test_every_target_has_stored_bytes_and_no_other_has():
    assert {path.name for path in KEPT.iterdir()} == TARGETS.keys()


@pytest.mark.parametrize("name", TARGETS)
def test_stored_bytes_break_nothing(name):
    for data in kept(name):
        TARGETS[name](data)


@pytest.mark.parametrize("name", TARGETS)
def test_random_bytes_break_nothing(name):
    @settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(damaged(kept(name)))
    def nothing_breaks(data):
        TARGETS[name](data)

    nothing_breaks()
