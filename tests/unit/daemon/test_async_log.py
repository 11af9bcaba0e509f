"""Logging that cannot block the loop."""

import logging
import os
import time

import pytest

from palmd.daemon.async_log import MAX_QUEUED_LINES, AsyncLog


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def say(journal, text):
    journal.handle(logging.LogRecord("palmd", logging.WARNING, __file__, 1, "%s", (text,), None))


def test_lines_arrive_in_order_with_their_level(pipe):
    journal = AsyncLog(pipe[1])
    say(journal, "one")
    say(journal, "two")
    journal.close()
    assert os.read(pipe[0], 1000) == b"WARNING one\nWARNING two\n"


def test_a_reader_that_does_not_read_blocks_nothing(pipe):
    journal = AsyncLog(pipe[1])
    begun = time.monotonic()
    for _ in range(3 * MAX_QUEUED_LINES):
        say(journal, "x" * 200)
    assert time.monotonic() - begun < 1.0
    begun = time.monotonic()
    journal.close()
    assert time.monotonic() - begun < 1.0
    os.read(pipe[0], 1 << 20)


def test_a_closed_standard_error_is_no_error():
    read, write = os.pipe()
    os.close(read)
    journal = AsyncLog(write)
    say(journal, "to nobody")
    journal.close()
    os.close(write)
