"""Every block of README and docs that needs no daemon is run, or states why it is not.

Blocks that need a daemon: `tests/rig/test_documentation_on_rig.py`.
"""

import re
import socket

import docblocks
import docreader
import pytest
import rig_recording

from palmd.config.any_config import as_yaml


def free_addresses():
    with socket.socket() as one, socket.socket() as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return tuple(f"tcp://127.0.0.1:{each.getsockname()[1]}" for each in (one, other))


SLOW = {"docs/operate/reports.md"}
"""Pages whose commands take long and have tests of their own."""
FASTER = {r"(palmd replay \S+)( --publish \S+)?$": r"\1\2 --speed 20"}
"""Replays that end by themselves, at the recorded pace on the page."""
PAGES = [
    pytest.param(page, marks=pytest.mark.nightly) if page in SLOW else page
    for page in docreader.pages(with_a_daemon=False)
]


@pytest.mark.parametrize("page", PAGES)
def test_blocks_of(page, tmp_path):
    config = tmp_path / "configured.yaml"
    config.write_text(as_yaml(rig_recording.configured()))
    reader = docreader.Reader(tmp_path, rig_recording.path(), config)
    for block in docreader.blocks_of(page, with_a_daemon=False):
        beside, _ = free_addresses()
        reader.run(block, free_addresses(), None, FASTER | {"tcp://127.0.0.1:9999": beside})


def test_every_block_has_a_kind_and_a_reason_if_it_is_not_run():
    for block in docblocks.blocks():
        assert block.kind in (*docblocks.RUN, *docblocks.SHOWN), f"{block.page}:{block.line}: {block.kind or 'no kind'}"
        if block.excluded:
            assert block.kind in docblocks.RUN, f"{block.page}:{block.line}: blocks of this kind are not run"
            assert len(block.excluded) > 8
            for name in re.findall(r"tests/[\w/]+(?:\.py)?", block.excluded):
                assert (docblocks.ROOT / name).exists(), f"{block.page}:{block.line}: there is no {name}"
    assert list(docblocks.indented()) == [], "fence them, so that they are run"


def test_most_blocks_are_run():
    """Exceptions are studies, installations, and blocks that need a person or a device."""
    kinds = [bool(block.excluded) for block in docblocks.blocks() if block.kind in docblocks.RUN]
    assert kinds.count(False) >= 25
