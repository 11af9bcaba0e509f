"""How many small faults, put into the modules that must not fail, the tests notice: cosmic-ray on a copy, sampled.

    python tools/mutants.py                     all of them: hours
    python tools/mutants.py --sample 60 --seed 1

Prints the score of each module and every survivor as a diff; the sample's seed repeats it. Nothing in the checkout is
touched. Exit status 1 when fewer than 90 % were killed.
"""

from __future__ import annotations

import argparse
import random
import secrets
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome

ROOT = Path(__file__).parent.parent
COPY = ROOT / "build" / "mutants"
GOAL = 0.90
TIMEOUT_S = 300

MODULES: dict[str, tuple[str, ...]] = {
    "daemon/lifecycle.py": ("unit/daemon/test_lifecycle.py", "unit/daemon/test_core.py"),
    "motion/limits.py": ("unit/motion", "property/test_setpoints_property.py"),
    "daemon/setpoints.py": ("unit/daemon/test_setpoints.py", "property/test_setpoints_property.py"),
    "devices/armlink.py": ("unit/devices/test_armlink.py",),
    "devices/armhost.py": ("unit/devices/test_armhost.py",),
    "faults.py": ("unit/test_faults.py",),
    "daemon/supervisor.py": ("unit/daemon/test_core.py", "unit/daemon/test_exploring.py"),
    "keys.py": ("unit/test_keys.py",),
}
"""The modules, and the tests that must notice what is wrong with them, the quickest first."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, metavar="N", help="only so many of each module's, drawn")
    parser.add_argument("--seed", type=int, help="of the sample; default: a random one, printed")
    parser.add_argument("--only", nargs="+", choices=MODULES, default=list(MODULES), metavar="MODULE")
    arguments = parser.parse_args()
    seed = secrets.randbelow(1 << 31) if arguments.seed is None else arguments.seed
    print(f"seed {seed}", flush=True)
    killed, all_of = Counter[str](), Counter[str]()
    for module in arguments.only:
        survivors, all_of[module] = _tried(module, arguments.sample, seed)
        killed[module] = all_of[module] - len(survivors)
        print(f"{module}: {killed[module]} of {all_of[module]} killed", flush=True)
        for text in survivors:
            print(text, flush=True)
    score = killed.total() / max(all_of.total(), 1)
    print(f"together: {killed.total()} of {all_of.total()} killed, {score:.0%}")
    return 0 if score >= GOAL else 1


def _tried(module: str, sample: int | None, seed: int) -> tuple[list[str], int]:
    """The survivors among a module's mutants, as diffs, and how many were tried."""
    shutil.rmtree(COPY, ignore_errors=True)
    for folder in ("src", "tests", "config", "tools", "docs"):
        shutil.copytree(ROOT / folder, COPY / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / file, COPY / file)
    tests = " ".join(f"tests/{each}" for each in MODULES[module])
    command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider -p no:randomly {tests}"
    (COPY / "mutants.toml").write_text(
        f'[cosmic-ray]\nmodule-path = "src/palmd/{module}"\ntimeout = {TIMEOUT_S}\nexcluded-modules = []\n'
        f'test-command = "{command}"\n[cosmic-ray.distributor]\nname = "local"\n',
        encoding="utf-8",
    )
    _run("init", "mutants.toml", "mutants.sqlite")
    path = str(COPY / "mutants.sqlite")
    with use_db(path, WorkDB.Mode.open) as database:
        items = sorted(database.work_items, key=lambda item: item.job_id)
        items.sort(key=lambda item: [(m.operator_name, m.occurrence) for m in item.mutations])
        chosen = items if sample is None else random.Random(f"{seed} {module}").sample(items, min(sample, len(items)))
        database.clear()
        database.add_work_items(chosen)
    _run("exec", "mutants.toml", "mutants.sqlite")
    with use_db(path, WorkDB.Mode.open) as database:
        survivors = [result.diff or "" for _, result in database.results if result.test_outcome is TestOutcome.SURVIVED]
    return survivors, len(chosen)


def _run(*arguments: str) -> None:
    environment = {"PYTHONPATH": str(COPY / "src"), "PATH": str(Path(sys.executable).parent), "HOME": str(Path.home())}
    subprocess.run(
        [sys.executable, "-m", "cosmic_ray.cli", *arguments], cwd=COPY, env=environment, check=True, timeout=None
    )


if __name__ == "__main__":
    sys.exit(main())
