"""The processes beside the loop: their memory is what they use."""

import ctypes
import gc
import weakref

import pytest

from palmd.daemon.beside import give_back_memory
from palmd.daemon.realtime import rss_mb


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the allocator is not glibc's")
def test_what_was_freed_between_blocks_still_in_use_is_given_back():
    begin = rss_mb()
    blocks = [bytes(4000) for _ in range(10_000)]
    kept = blocks[::100]
    del blocks
    held = rss_mb() - begin
    give_back_memory()
    left = rss_mb() - begin
    assert held > 30.0, "the blocks between those kept should still be resident, else this test shows nothing"
    assert left < 5.0
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
        give_back_memory()
        assert gone() is None
    finally:
        gc.enable()
