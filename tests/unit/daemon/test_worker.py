"""The processes beside the loop: their memory is what they use."""

import ctypes
import gc
import weakref

import pytest

from palmd.daemon.realtime import rss_mb
from palmd.daemon.worker import release_memory


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the allocator is not glibc's")
def test_what_was_freed_between_blocks_still_in_use_is_given_back():
    blocks = [bytes(4000) for _ in range(10_000)]
    kept = blocks[::100]
    del blocks
    before = rss_mb()
    release_memory()
    assert before - rss_mb() > 30.0, "of the 40 MB"
    assert len(kept) == 100


def test_what_only_points_to_itself_is_given_back():
    class Knot:
        pass

    one, other = Knot(), Knot()
    one.other, other.other = other, one
    gone = weakref.ref(one)
    gc.disable()
    try:
        del one, other
        assert gone() is not None
        release_memory()
        assert gone() is None
    finally:
        gc.enable()
