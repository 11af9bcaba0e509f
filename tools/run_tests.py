"""All tests: those on the emulated rig one by one in real time, and in what they leave of the machine all others.

A rig's test sleeps most of the time, but what it starts must be awake when it is due; so the others stand back.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

NICE = 10
PYTEST = (sys.executable, "-m", "pytest", "-q")
RIG = ("tests/rig", "tests/system")
OTHERS = ("-n", "2", "--dist", "worksteal", *(f"--ignore={folder}" for folder in (*RIG, "tests/bench", "tests/vm")))


def main(arguments: list[str]) -> int:
    """0 when all have passed; `arguments` go to both halves."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # some hundred processes import the same
    with tempfile.TemporaryFile("w+") as told:
        others = subprocess.Popen(
            [*PYTEST, *OTHERS, *arguments], stdout=told, stderr=told, preexec_fn=lambda: os.nice(NICE)
        )
        try:
            rig = subprocess.run([*PYTEST, *RIG, *arguments], check=False).returncode
            status = others.wait()
        finally:
            others.terminate()
        told.seek(0)
        print(told.read(), end="")
    return int(bool(rig or status))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
