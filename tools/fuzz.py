"""Coverage-guided fuzzing of the readers in tests/fuzz/targets.py, with atheris.

    python tools/fuzz.py versapad --runs 1000000 --corpus /tmp/versapad

Starts from tests/fuzz/corpus/TARGET and keeps inputs that reach new code in --corpus. Inputs that break the target are
written there as crash-… or timeout-…, and the exit status is not 0. Needs the extra `fuzz`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "tests" / "fuzz" / "corpus"
HANG_S = 10


def main() -> int:
    sys.path.insert(0, str(ROOT / "tests" / "fuzz"))
    try:
        import atheris
    except ModuleNotFoundError:
        print("atheris is missing: pip install -e .[fuzz]", file=sys.stderr)
        return 1
    with atheris.instrument_imports(include=["palmd", "targets"]):
        from targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=TARGETS, metavar="TARGET", help=", ".join(TARGETS))
    parser.add_argument(
        "--runs", type=int, default=100_000, metavar="N", help="number of inputs (default: %(default)s)"
    )
    parser.add_argument("--seconds", type=int, default=0, metavar="S", help="time limit; 0: none")
    parser.add_argument("--corpus", type=Path, required=True, metavar="DIR", help="folder for inputs that are found")
    arguments = parser.parse_args()
    arguments.corpus.mkdir(parents=True, exist_ok=True)
    kept = KEPT / arguments.target
    atheris.Setup(
        [
            sys.argv[0],
            f"-runs={arguments.runs}",
            f"-max_total_time={arguments.seconds}",
            f"-timeout={HANG_S}",
            f"-artifact_prefix={arguments.corpus}/",
            "-print_final_stats=1",
            str(arguments.corpus),
            *([str(kept)] if kept.is_dir() else []),
        ],
        TARGETS[arguments.target],
    )
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
