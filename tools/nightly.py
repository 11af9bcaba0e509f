"""Long campaigns with new seeds each night: `make nightly`, or `tools/nightly.py FOLDER [NAME …]`.

Each writes its rows and its output into the folder. Exit status 1 if one of them missed a goal or failed.
"""

from __future__ import annotations

import datetime
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent

CAMPAIGNS: dict[str, str] = {
    "montecarlo": "montecarlo --runs 10 --seed {seed} -o {folder}/montecarlo",
    "montecarlo-calibrated": "montecarlo --runs 10 --seed {seed} --imperfections calibrated -o {folder}/calibrated",
    "sbc": "sbc --runs 20 --seed {seed} -o {folder}/sbc.jsonl",
    "miscalibration": "miscalibration --runs 1 --seed {seed} -o {folder}/miscalibration.jsonl",
    "explore": "explore --runs 1 --seed {seed} -o {folder}/explore",
    "pivot": "pivot --runs 10 --seed {seed} -o {folder}/pivot.jsonl",
    "pivot-live": "pivot --live --runs 3 --seed {seed} -o {folder}/pivot-live.jsonl",
    "space": "space --runs 2 --seed {seed} -o {folder}/space.jsonl",
    "test-objects": "test-objects --runs 2 --seed {seed} -o {folder}/test-objects.jsonl",
    "test-objects-offline": "test-objects --offline --runs 1 --seed {seed} -o {folder}/test-objects-offline.jsonl",
    "engines": "engines --runs 1 --seed {seed} -o {folder}/engines.jsonl",
    "false-alarms": "false-alarms arm --light --runs 4 --seconds 900 --seed {seed} -o {folder}/false-alarms.jsonl",
    "simulate": "simulate --fresh 1800",
    "faults": "faults --seed {seed} -o {folder}/faults",
    "soak": "soak --seed {seed} -o {folder}/soak",
}
"""Arguments of `python -m tools.studies`, by the campaign's name."""
TESTS = "tests"  # the campaign of all tests marked `nightly`


def main(folder: Path, names: list[str]) -> int:
    """Run the named campaigns, or all, one after the other."""
    every = (TESTS, *CAMPAIGNS)
    unknown = [name for name in names if name not in every]
    if unknown:
        print(f"no campaign {', '.join(unknown)}; choose from {', '.join(every)}", file=sys.stderr)
        return 2
    folder.mkdir(parents=True, exist_ok=True)
    seed = 1000 * datetime.datetime.now(datetime.UTC).date().toordinal()
    failed = []
    for name in names or every:
        if name == TESTS:
            arguments = ["pytest", "-q", "-m", "nightly", "tests"]
        else:
            arguments = ["tools.studies", *CAMPAIGNS[name].format(seed=seed, folder=folder).split()]
        t_start = time.monotonic()
        with (folder / f"{name}.txt").open("w", encoding="utf-8") as out:
            command = [sys.executable, "-m", *arguments]
            status = subprocess.run(command, cwd=ROOT, stdout=out, stderr=out, check=False).returncode
        print(
            f"{name}: {'good' if status == 0 else f'status {status}'}, {time.monotonic() - t_start:.0f} s", flush=True
        )
        failed += [name] * (status != 0)
    print(f"seeds from {seed}; failed: {', '.join(failed) or 'nothing'}; {folder}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).absolute(), sys.argv[2:]))
