"""Make the figures of README and docs and record how: `make figures`, `python -m tools.figures [GROUP …]`.

`docs/figures/made.csv` has a line for each figure: command, seed, date and commit. Groups that take an hour are made
only if they are named. Figures of studies that are no longer in the tree stay as they are, with the commit that has the
study.
"""

from __future__ import annotations

import csv
import datetime
import io
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools import make_ground_truth_figures, make_pad_figure, page_pictures

ROOT = Path(__file__).parent.parent
FIGURES, MADE = ROOT / "docs/figures", ROOT / "docs/figures/made.csv"
COLUMNS = ("file", "command", "seed", "date", "commit")


@dataclass(frozen=True, slots=True)
class Group:
    """Figures that are made together.

    make: function of the folder, None if they cannot be made any more; `command` is then how they were made. slow:
    takes an hour.
    """

    files: Sequence[str]
    seed: str
    make: Callable[[Path], object] | None = None
    command: str = ""
    slow: bool = False


def _study(words: str, copied: str) -> Callable[[Path], object]:
    """A function that runs a study and copies its figure."""

    def make(folder: Path) -> None:
        output = ROOT / "build/figures" / copied
        command = [sys.executable, "-m", "tools.studies", *words.split(), "-o", str(output)]
        subprocess.run(command, cwd=ROOT, check=True)
        (folder / copied).write_bytes(next(output.glob("*.svg")).read_bytes())

    return make


def _drawings(_folder: Path) -> None:
    subprocess.run([sys.executable, "tools/make_docs.py"], cwd=ROOT, check=True)


def _ground_truth(folder: Path) -> None:
    make_ground_truth_figures.camera(folder / "camera.svg")
    make_ground_truth_figures.pruning(folder / "pruning.svg")


MONTECARLO = "montecarlo --runs 20 --seed 2000"
EXPLORE = "explore --runs 12 --kind all --seed 20000"
GROUPS: dict[str, Group] = {
    "page": Group(page_pictures.NAMES, f"palmd demo --seed {page_pictures.SEED}", page_pictures.take),
    "drawings": Group(
        ("tabletop.svg", "tabletop-assembly.svg", "tabletop-wiring.svg", "adept-linkage.svg"), "none", _drawings
    ),
    "pad": Group(("pad.svg",), "1", lambda folder: make_pad_figure.draw(folder / "pad.svg")),
    "ground-truth": Group(("camera.svg", "pruning.svg"), "rig 3, odd 67", _ground_truth),
    "montecarlo": Group(("montecarlo.svg",), "from 2000", _study(MONTECARLO, "montecarlo.svg"), slow=True),
    "explore": Group(("explore.svg",), "from 20000", _study(EXPLORE, "explore.svg"), slow=True),
    "paper": Group(
        ("paper_simulation.svg", "paper_frames.svg", "paper_experiment.svg", "stable_poses.svg", "ambiguous.svg",
         "observability.svg"), "the paper's runs", command="palmd report paper, of commit e16fddd0"
    ),
    "outlook": Group(
        ("outlook_coverage.svg", "outlook_pivot.svg"), "none named",
        command="python -m tools.studies outlook -o FOLDER, of commit 74c4bc87",
    ),
}  # fmt: skip


def main(names: Sequence[str]) -> int:
    """Make the named groups, or all that are not slow; returns 1 if one failed, 2 for an unknown name."""
    unknown = [name for name in names if name not in GROUPS or GROUPS[name].make is None]
    if unknown:
        print(f"cannot make {', '.join(unknown)}; groups: {', '.join(GROUPS)}", file=sys.stderr)
        return 2
    rows, status = made(), 0
    for name, group in GROUPS.items():
        for file in set(group.files) - set(rows):
            rows[file] = (group.command or "before this table", "", *_last_changed(file))
        if group.make is None or (name not in names if names else group.slow):
            continue
        print(f"{name}: {', '.join(group.files)}", flush=True)
        try:
            group.make(FIGURES)
        except (RuntimeError, subprocess.CalledProcessError) as error:
            print(f"{name} is unchanged: {error}", file=sys.stderr)
            status = 1
            continue
        now = f"python -m tools.figures {name}", group.seed, _today(), _git("rev-parse", "--short=8", "HEAD")
        rows |= dict.fromkeys(group.files, now)
    MADE.write_text(as_text(rows), encoding="utf-8")
    return status


def made() -> dict[str, tuple[str, ...]]:
    """The rows of `made.csv`, by file."""
    if not MADE.exists():
        return {}
    with MADE.open(encoding="utf-8", newline="") as stream:
        return {row[0]: tuple(row[1:]) for row in list(csv.reader(stream))[1:]}


def as_text(rows: dict[str, tuple[str, ...]]) -> str:
    """The table, sorted by file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows((file, *row) for file, row in sorted(rows.items()))
    return text.getvalue()


def _last_changed(file: str) -> tuple[str, str]:
    date, commit = _git("log", "-1", "--format=%cs %h", "--abbrev=8", "--", f"docs/figures/{file}").split()
    return date, commit


def _today() -> str:
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
