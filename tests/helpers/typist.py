"""A command at a terminal of its own, and who types there."""

import fcntl
import os
import pty
import select
import subprocess
import sys
import termios
import time

CTRL_C = "\x03"


class Typist:
    """Reads what a palmd command asks on its terminal, and types; standard output goes to a pipe."""

    def __init__(self, *arguments):
        self._far, near = pty.openpty()
        self.said, self._seen = "", 0
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "palmd", *map(str, arguments)],
            stdin=near, stdout=subprocess.PIPE, stderr=near, text=True, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(near, termios.TIOCSCTTY, 0),
        )  # fmt: skip
        os.close(near)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.communicate()
        os.close(self._far)

    def until(self, text, within_s, *, unless=""):
        """Wait until it has said this, after what was waited for before; to each question `unless`, Enter."""
        deadline = time.monotonic() + within_s
        while (at := self.said.find(text, self._seen)) < 0:
            if unless and (asked := self.said.find(unless, self._seen)) >= 0:
                self._seen = asked + len(unless)
                self.type("")
            assert self._hear(deadline), f"it does not say {text!r}: {self.said[self._seen :]}"
        self._seen = at + len(text)

    def type(self, line):
        """Type a line and Enter."""
        os.write(self._far, f"{line}\n".encode())

    def press(self, key):
        """Press one key."""
        os.write(self._far, key.encode())

    def end(self, within_s):
        """Wait for its end; returns the exit status and its standard output."""
        deadline = time.monotonic() + within_s
        while self._hear(deadline):
            pass
        out, _ = self._process.communicate(timeout=max(deadline - time.monotonic(), 1.0))
        return self._process.returncode, out

    def _hear(self, deadline):
        """Take what it says next; False at its end, or if it says nothing until the deadline."""
        if not select.select([self._far], [], [], max(deadline - time.monotonic(), 0.0))[0]:
            return False
        try:
            data = os.read(self._far, 65536)
        except OSError:  # the other end is closed
            return False
        self.said += data.decode(errors="replace").replace("\r\n", "\n")
        return bool(data)
