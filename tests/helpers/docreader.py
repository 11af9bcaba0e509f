"""Runs the commands of README and docs in a terminal, in a temporary folder.

The pages' usual addresses are replaced by free ones; RUN is a recording. Other files that a page names are created in
that folder first.
"""

import math
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress

from docblocks import ROOT, RUN, Block, blocks
from waiting import wait
from zmq.auth import create_certificates

import palmd
from palmd.console.errors import RIG_FAILED
from palmd.model.compiled import cache_directory
from tools.tabletop.geometry import TABLETOP
from tools.tabletop.mjcf import mjcf

PATIENCE_S = 120.0  # for one command on a busy machine
LIVES_S, SILENT_S, ENTERS = 1.0, 5.0, 40
INTERRUPTED = 130
RECORDINGS = ("runs/2026-11-21T22-30-05Z.mcap", "runs/2026-11-22T09-12-44Z.mcap", "run.mcap")

WITH_A_DAEMON = re.compile(r"palmd (?:run|ctl|top|view|demo)\b|palmd\.connect|socket\.c")
ENDLESS = re.compile(r"palmd (?:run|view|top|demo|ctl explore)\b|--loop\b")
"""Commands that run until Ctrl-C, or too long for a test."""

ADDRESSES = """\
from palmd.bus import link
link.PUBLISH, link.COMMAND = {publish!r}, {command!r}
"""


def pages(*, with_a_daemon):
    """Pages that have blocks to run, with or without a daemon."""
    return list(dict.fromkeys(block.page for block in blocks() if _is_run(block, with_a_daemon)))


def blocks_of(page, *, with_a_daemon):
    """The blocks of a page, in order."""
    return [block for block in blocks() if block.page == page and _is_run(block, with_a_daemon)]


def _is_run(block, with_a_daemon):
    return block.kind in RUN and not block.excluded and bool(WITH_A_DAEMON.search(block.text)) == with_a_daemon


class Reader:
    """`config` serves as the reader's own configuration; its `plans` lie beside it."""

    def __init__(self, folder, recording, config):
        self.folder, self._home, self._config = folder, folder / "home", config
        self._program, self._endless = "", []
        for path in (self._home / ".config/palmd", folder / "runs", folder / "tools", folder / "build/kit"):
            path.mkdir(parents=True)
        for name in RECORDINGS:
            shutil.copy(recording, folder / name)
        shutil.copytree(ROOT / "config", folder / "config")
        shutil.copytree(ROOT / "config/plans", folder / "plans")
        for mine in ("mine.yaml", "plans/mine.yaml"):
            shutil.copy(ROOT / "config/plans/rock.yaml", folder / mine)
        (folder / "build/kit/rig.xml").write_text(mjcf(TABLETOP))
        (folder / "track.tum").write_text("".join(_as_seen(palmd.open(recording))))
        for name in ("desk", "server"):
            create_certificates(folder, name)
        scp = folder / "tools/scp"
        scp.write_text('#!/bin/sh\ncase "$1" in rig:*) cp keys/server.key "$2";; *) cp "$1" "$HOME";; esac\n')
        scp.chmod(0o755)

    def run(self, block: Block, addresses, daemon_is_ready, words):
        """Runs a block; `addresses` are those for publishing and commands, `words` replaces other text of the page.

        Raises AssertionError with the output if a command fails.
        """
        (self.folder / "my.yaml").unlink(missing_ok=True)
        if "palmd init" not in block.text:
            shutil.copy(self._config, self.folder / "my.yaml")
        publish, command = addresses
        (self.folder / "tools/sitecustomize.py").write_text(ADDRESSES.format(publish=publish, command=command))
        usual = {"tcp://127.0.0.1:98[78]2": publish, "tcp://127.0.0.1:98[78]3": command, "--port 8790": "--port 0",
                 "palmd view": "palmd view --port 0", "runs/….mcap": RECORDINGS[0], "RUN": RECORDINGS[0]}  # fmt: skip
        try:
            if block.kind == "python":
                before = "" if block.text.startswith("import ") else self._program  # continues it
                self._program = before + replaced(block.text, usual | words)
                self._typed([sys.executable, "-c", self._program])
                return
            for line in block.lines:
                typed = ["bash", "-e", "-c", replaced(line, usual | words)]
                if ENDLESS.search(line):
                    self._begun(typed)
                    if "palmd run" in line:
                        daemon_is_ready()  # the daemon keeps running during the commands that follow
                    else:
                        self._interrupted()
                else:
                    self._typed(typed)
        except AssertionError as error:
            raise AssertionError(f"{block.page}:{block.line}: {error}") from None
        finally:
            self._interrupted()

    def _typed(self, words):
        out = self.folder / "said"
        with self._process(words, out) as process:
            try:
                status = process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                status = f"none after {PATIENCE_S:g} s"
        assert status == 0, f"{words[-1]}: status {status}\n{out.read_text()}"

    def _begun(self, words):
        out = self.folder / f"said-{len(self._endless)}"
        process = self._process(words, out)
        self._endless.append((words, process, out))
        with suppress(AssertionError):  # some commands print nothing
            wait(lambda: process.poll() is not None or out.stat().st_size, "a word", patience_s=SILENT_S)
        with suppress(subprocess.TimeoutExpired):
            process.wait(LIVES_S)

    def _interrupted(self):
        """Ends endless commands by Ctrl-C and checks their exit status; a demo may report that it had no time to
        converge.
        """
        while self._endless:
            words, process, out = self._endless.pop()
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGINT)
            try:
                status = process.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                status = "none after Ctrl-C"
            said = f"{words[-1]}: status {status}\n{out.read_text()}"
            assert "Traceback" not in said, said
            assert status in {0, INTERRUPTED, *([RIG_FAILED] if "palmd demo" in words[-1] else [])}, said

    def _process(self, words, out):
        """Answers each prompt as usual."""
        with out.open("wb") as said:
            process = subprocess.Popen(
                words, cwd=self.folder, env=self._environment(), stdin=subprocess.PIPE, stdout=said,
                stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        with suppress(BrokenPipeError):
            process.stdin.write(b"\n" * ENTERS)
            process.stdin.close()
        return process

    def _environment(self):
        paths = [str(self.folder / "tools"), str(sys.prefix + "/bin"), os.environ["PATH"]]
        return {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")} | {
            "PATH": os.pathsep.join(paths), "PYTHONPATH": str(self.folder / "tools"), "HOME": str(self._home),
            "CACHE_DIRECTORY": str(cache_directory()),
        }  # fmt: skip


def replaced(text, words):
    """The text with each pattern of `words` replaced."""
    for old, new in words.items():
        text = re.sub(rf"(?<!\w){old}\b", new, text)
    return text


def _as_seen(run):
    """The object's rotation as another system would measure it, as lines of a TUM file."""
    rows = run.estimates
    for stamp, psi, valid in zip(rows["timestamp"], rows["psi_rad"], rows["valid"], strict=True):
        if valid:
            yield f"{stamp:.4f} 0 0 0 0 0 {math.sin(psi / 2):.6f} {math.cos(psi / 2):.6f}\n"
