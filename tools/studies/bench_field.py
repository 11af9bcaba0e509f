"""The benchmark of the field: two-palm runs with their truth, baselines, and a scorer that takes anybody's results.

Makes the runs (an event log and its truth each, from the emulated rig as calibration leaves one), has the baselines
estimate them, scores everything and prints the table. What is there already is not made again: delete results.jsonl to
have the baselines anew. docs/results/field.md tells the form of runs and results, and what came out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from palmd.console.arguments import count, seconds_within, seed
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.console.extras import missing, only_without
from palmd.jsonvalues import or_none
from palmd.record.eventlog import read_log
from tools.studies import workers
from tools.studies.field_runs import name_of, written
from tools.studies.field_score import HEAD, FieldScore, ResultLineError, scored, table
from tools.studies.peers.task import PeerTruth
from tools.studies.rows import Sink, collected

Line = dict[str, Any]

RUNS, RESULTS, SCORES = "runs", "results.jsonl", "scores.json"


@dataclass(frozen=True, slots=True)
class FieldRun:
    """One run to make: in which folder, by which seed, how long (s)."""

    folder: Path
    seed: int
    seconds: float


@dataclass(frozen=True, slots=True)
class FieldEstimate:
    """One run to be estimated by one of the baselines."""

    folder: Path
    run: str
    method: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--runs", type=count, default=200, metavar="N", help="how many (default: %(default)s)")
    add("--seed", type=seed, default=0, metavar="FIRST", help="the first run's (default: %(default)s)")
    add("--seconds", type=seconds_within(2.0, 60.0), default=4.0, metavar="S",
        help="how long each lasts (default: %(default)g)")  # fmt: skip
    add("--results", type=Path, nargs="+", default=[], metavar="FILE", help="score these too: your own method's")
    add("--no-baselines", action="store_true", help="make the runs, and score what is there, without the baselines")
    add("-o", "--output", type=Path, default=Path("field"), metavar="FOLDER", help="(default: %(default)s)")
    workers.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Interrupted, it scores what is finished until then; CliError when it cannot begin or a result cannot be read."""
    folder = arguments.output.resolve()
    if not arguments.no_baselines:
        _need_filterpy()
    try:
        (folder / RUNS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CliError(BAD_INPUT, f"{arguments.output}: cannot be made: {error.strerror or error}") from None
    seeds = range(arguments.seed, arguments.seed + arguments.runs)
    print(f"seeds {seeds[0]} to {seeds[-1]}, {arguments.seconds:g} s each")
    hands = workers.asked_for(arguments)
    wanted = [
        FieldRun(folder / RUNS, seed, arguments.seconds) for seed in seeds if not _made(folder, seed, arguments.seconds)
    ]
    errors, status = collected("runs", wanted, make, not_made, hands)
    if any(errors) or status:
        print("\n".join(filter(None, errors)))
        return status or RIG_FAILED
    own = folder / RESULTS
    if not arguments.no_baselines:
        status = _estimate(own, folder, [name_of(seed) for seed in seeds], hands)
    _conclude(folder, [*([own] if own.exists() else []), *arguments.results])
    return status


def make(task: FieldRun) -> str:
    """Makes a run; an empty text, what `not_made` says otherwise."""
    try:
        written(task.folder, task.seed, task.seconds)
    except Exception as error:
        return not_made(task, error)
    return ""


def not_made(task: FieldRun, error: BaseException) -> str:
    """Which run could not be made, and why."""
    return f"{name_of(task.seed)}: {type(error).__name__}: {error}"


def estimate(task: FieldEstimate) -> Line:
    """One line of results, with the processor time that it took; what raises becomes a line that says so."""
    try:
        return _estimated(task)
    except Exception as error:
        return not_estimated(task, error)


def _estimated(task: FieldEstimate) -> Line:
    from tools.studies.field_methods import METHODS, warmed_up

    warmed_up(task.method)
    log = read_log(task.folder / f"{task.run}.jsonl")
    begun = time.process_time()
    told = METHODS[task.method](log)
    cpu_s = round(time.process_time() - begun, 3)
    return {"method": task.method, "run": task.run, "cpu_s": cpu_s} | told


def not_estimated(task: FieldEstimate, error: BaseException) -> Line:
    """A line of results that tells nothing but why."""
    return {"method": task.method, "run": task.run, "error": f"{type(error).__name__}: {error}"}


def _estimate(own: Path, folder: Path, names: Sequence[str], hands: Callable[[ExitStack], Executor]) -> int:
    """Has the baselines estimate what they have not yet, each line kept as soon as it is there; the exit status."""
    from tools.studies.field_methods import METHODS

    done = {(line["run"], line["method"]) for _, line in _lines(own)} if own.exists() else set()
    tasks = [FieldEstimate(folder / RUNS, run, name) for run in names for name in METHODS if (run, name) not in done]
    lines, status = collected("estimates", tasks, estimate, not_estimated, hands, Sink[Line](own, dict, append=True))
    for line in lines:
        if "error" in line:
            print(f"{line['method']}, run {line['run']}: {line['error']}")
    return status


def _need_filterpy() -> None:
    try:
        import filterpy  # type: ignore[import-untyped]  # noqa: F401
    except ModuleNotFoundError as error:
        only_without("filterpy", error)
        raise missing("the study field", "filterpy", "studies") from None


def _made(folder: Path, seed: int, seconds: float) -> bool:
    """Whether the run is there; CliError when it lasts otherwise."""
    path = folder / RUNS / f"{name_of(seed)}.truth.json"
    if not path.exists():
        return False
    truth = _truth(folder, name_of(seed))
    lasts = float(truth.t[-1] - truth.t[0])
    if abs(lasts - seconds) > 0.1:
        raise CliError(BAD_INPUT, f"{path}: is of a run of {lasts:.1f} s, not {seconds:g} s; take another folder")
    return True


def _conclude(folder: Path, files: Sequence[Path]) -> None:
    scores = sorted((score for path in files for score in _scores(folder, path)), key=lambda score: score.run)
    for line in _columns([HEAD, *table(scores)]):
        print(line)
    plain = [or_none(asdict(score)) for score in scores]
    (folder / SCORES).write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"written: {folder / SCORES}")


def _scores(folder: Path, path: Path) -> list[FieldScore]:
    truth = cache(lambda name: _truth(folder, name))
    scores = []
    for number, line in _lines(path):
        try:
            scores.append(scored(line, truth(line["run"])))
        except ResultLineError as error:
            raise CliError(BAD_INPUT, f"{path}:{number}: {error}") from None
        except FileNotFoundError:
            known = f"there is no run {line['run']!r} in {folder / RUNS}"
            raise CliError(BAD_INPUT, f"{path}:{number}: {known}") from None
    return scores


def _truth(folder: Path, name: str) -> PeerTruth:
    if not name.isalnum():
        raise FileNotFoundError(name)
    path = folder / RUNS / f"{name}.truth.json"
    text = path.read_text(encoding="utf-8")
    try:
        return PeerTruth.from_fields(json.loads(text))
    except (ValueError, KeyError, TypeError) as error:
        raise CliError(BAD_INPUT, f"{path}: is not the truth of a run: {error!r}") from None


def _lines(path: Path) -> list[tuple[int, Line]]:
    """The lines of a file of results with their numbers; CliError for what is none."""
    try:
        texts = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise CliError(BAD_INPUT, f"{path}: cannot be read: {error}") from None
    found = []
    for number, text in enumerate(texts, 1):
        if not text.strip():
            continue
        try:
            line = json.loads(text)
        except ValueError as error:
            raise CliError(BAD_INPUT, f"{path}:{number}: not JSON: {error}") from None
        if not isinstance(line, dict) or not all(isinstance(line.get(name), str) for name in ("method", "run")):
            raise CliError(BAD_INPUT, f'{path}:{number}: a result is an object with "method" and "run", both texts')
        found.append((number, line))
    return found


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
