"""Benches: one shared by a module's tests, or one for a test alone. Nothing of them is left."""

import pytest
from harness import Bench


def _bench(folder):
    bench = Bench(folder)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A daemon on a rig, shared: a test leaves it in any state, and takes it from any."""
    yield from _bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def own_bench(tmp_path):
    """A daemon on a rig that nobody else uses."""
    yield from _bench(tmp_path)
