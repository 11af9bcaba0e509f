"""Worker processes return memory that they no longer use."""

import ctypes
import gc
import weakref

import pytest

from palmd.daemon.realtime import rss_mb
from palmd.daemon.worker import release_memory


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the allocator is not glibc's")
def test_freed_memory_between_used_blocks_is_returned():
    blocks = [bytes(4000) for _ in range(10_000)]
    kept = blocks[::100]
    del blocks
    before = rss_mb()
    release_memory()
    assert before - rss_mb() > 30.0, "of the 40 MB"
    assert len(kept) == 100


def test_reference_cycles_are_collected():
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
