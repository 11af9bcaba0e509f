"""Daemon and rig in one process on virtual time: everything that may go wrong at once, and what must hold all the same.

One seed draws plan, faults, commands of several clients, damaged bytes, stalls, slow helpers, clock steps and restarts;
invariants are checked at every tick. A run that breaks one is shrunk to the happenings that matter and told as one
command, which repeats it bit for bit. Most runs have a light rig and an observer that costs nothing. Exit status 1 when
an invariant was broken.
"""

from __future__ import annotations

import argparse
import math
import secrets
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from statistics import median
from typing import NoReturn

from palmd.cli import INTERRUPTED
from palmd.console.arguments import count, seconds
from palmd.console.columns import aligned
from palmd.console.errors import BAD_INPUT
from palmd.console.progress import Progress
from tools.studies import runs
from tools.studies.rows import on_this_machine, terminable
from tools.studies.simulation.happenings import RATE_HZ, Scenario, coarsened, drawn
from tools.studies.simulation.long import BLOCK_S, Life, calm, live, troubled
from tools.studies.simulation.reach import SOUGHT, sought
from tools.studies.simulation.reached import Triple, never_reached
from tools.studies.simulation.run import Outcome, simulate
from tools.studies.simulation.shrink import shrunk
from tools.studies.simulation.standstill import standstills

SEEDS_MOST = 1 << 63
TOLD_MISSING = 40
STANDSTILL_SEED = 100
GOAL_MEDIAN_MS, GOAL_WORST_MS = 80, 130


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--seeds", type=_seeds, metavar="A..B", help="from A up to B, both included")
    which.add_argument(
        "--fresh", type=seconds, metavar="S", help="seeds nobody has tried, for so many processor seconds; default: 60"
    )
    which.add_argument(
        "--standstill",
        type=count,
        metavar="N",
        help="instead: N times each cause that stops the arm, and how soon it stands",
    )
    which.add_argument(
        "--clean", type=float, metavar="H", help="instead: H hours in which nothing happens: every hold, and who leaks"
    )
    which.add_argument(
        "--long", type=float, metavar="H", help="instead: H hours of trouble for one daemon: what breaks, and who leaks"
    )
    add("--seed", type=int, default=STANDSTILL_SEED, metavar="N", help="of --standstill, --clean, --long")
    add(
        "--reach",
        action="store_true",
        help="each seed seeks one fault in every state, for every command to find it; default: all of them once",
    )
    add(
        "--coarse", action="store_true", help="for more hours: longer steps of the rig, adapters that deliver each 4 ms"
    )
    add("--rate", type=float, default=RATE_HZ, metavar="HZ", help="of the daemon's loop; default: %(default)g")
    add("--jobs", type=count, default=1, metavar="J", help="of --seeds: so many processes; default: %(default)s")
    add("--keep", type=_numbers, metavar="N,N…", help="of one seed's happenings only these")
    add("--list", action="store_true", help="tell a single seed's happenings")
    add("--unreached", action="store_true", help="tell every (state, fault, command) that was not seen")


def run(arguments: argparse.Namespace) -> int:
    """Status 1 when an invariant was broken; usage error for happenings of more than one seed."""
    if arguments.standstill is not None:
        return _standstill(arguments.standstill, arguments.seed)
    if arguments.clean is not None:
        life = live(calm(arguments.clean, arguments.seed))
        print(f"{life.holds} holds in {life.hours:.2f} simulated hours in which nothing happened")
        return _tell_life(life) or (BAD_INPUT if life.holds else 0)
    if arguments.long is not None:
        life = live(troubled(arguments.long, arguments.seed), BLOCK_S)
        print(f"{life.hours:.2f} simulated hours of one daemon, {life.holds} holds and stops")
        return _tell_life(life)
    told: range | None = arguments.seeds
    if told is None and arguments.reach and arguments.fresh is None:
        told = range(len(SOUGHT))
    seeds: Iterable[int] = _fresh(arguments.fresh or 60.0) if told is None else told
    single = told is not None and len(told) == 1
    if (arguments.keep is not None or arguments.list) and not single:
        print("--keep and --list are for one seed: --seeds A..A", file=sys.stderr)
        return BAD_INPUT
    simulated_s, spent, done, failed = 0.0, 0.0, 0, 0
    seen: Counter[Triple] = Counter()
    sometimes: Counter[str] = Counter()
    total = 0 if told is None else len(told)
    interrupted = False
    with Progress("simulate", total, "runs") as progress:
        try:
            for outcome, took_s in _outcomes(seeds, arguments):
                seed = outcome.scenario.seed
                done += 1
                simulated_s, spent = simulated_s + outcome.simulated_s, spent + took_s
                seen += outcome.seen
                sometimes += outcome.sometimes
                if arguments.list:
                    _list(outcome.scenario)
                if outcome.breach is not None:
                    failed += 1
                    how = "--reach " * arguments.reach + "--coarse " * arguments.coarse
                    how += f"--rate {arguments.rate:g} " * (arguments.rate != RATE_HZ)
                    _tell(outcome, f"{how}--seeds", shrink=arguments.keep is None)
                elif single:
                    print(f"seed {seed}: every invariant held; digest {outcome.digest}")
                if total:
                    progress.at(done)
        except KeyboardInterrupt:
            interrupted = True
            print("interrupted; until then:")
    print(
        f"{done} runs, {simulated_s / 3600:.2f} simulated hours, {failed} with a broken invariant; "
        f"{simulated_s / max(spent, 1e-9):.1f} simulated hours per processor hour"
    )
    print(f"sometimes: {', '.join(f'{name} {number}' for name, number in sorted(sometimes.items()))}")
    _tell_reached(seen, whole=arguments.unreached)
    return BAD_INPUT if failed else INTERRUPTED if interrupted else 0


def _outcomes(seeds: Iterable[int], arguments: argparse.Namespace) -> Iterator[tuple[Outcome, float]]:
    """What comes of each seed, and the processor time (s) it took, as they are finished; in this process or others."""
    run = partial(_outcome, keep=arguments.keep, reach=arguments.reach, coarse=arguments.coarse, rate_hz=arguments.rate)
    if arguments.jobs == 1 or not isinstance(seeds, range):
        yield from map(run, seeds)
        return
    with terminable(), ExitStack() as stack:
        yield from runs.finished(on_this_machine(arguments.jobs)(stack), run, _ended, seeds)


def _outcome(
    seed: int, *, keep: Sequence[int] | None, reach: bool, coarse: bool, rate_hz: float
) -> tuple[Outcome, float]:
    """Of the happenings to keep only, if told so: a director's are known when it has run."""
    begun = time.process_time()
    scenario = replace(sought(seed) if reach else drawn(seed), rate_hz=rate_hz)
    if coarse and not reach:
        scenario = coarsened(scenario)
    if reach and keep is not None:
        scenario = simulate(scenario).scenario
    outcome = simulate(scenario if keep is None else scenario.keeping(keep))
    return outcome, time.process_time() - begun


def _ended(seed: int, error: BaseException) -> NoReturn:
    """A run that raised is a bug of the simulation's own."""
    raise RuntimeError(f"seed {seed}: {error!r}") from error


def _tell_life(life: Life) -> int:
    print(life.held)
    for leak in life.leaks:
        print(f"  more and more: {leak}")
    if life.breach is not None:
        print(f"broken: {life.breach}")
    return BAD_INPUT if life.breach or life.leaks else 0


def _standstill(times: int, seed: int) -> int:
    """How soon the arm stands; the goals are told beside, and no reason for another status."""
    found: dict[str, list[float]] = {}
    for one in standstills(times, seed):
        found.setdefault(one.name, []).append(one.still_s * 1e3)
    rows = [(name, (f"{median(some):.0f}", f"{max(some):.0f}")) for name, some in found.items()]
    print(aligned([("cause to standstill, ms", ("median", "worst")), *rows]))
    every = [still for some in found.values() for still in some]
    goals = f"goals {GOAL_MEDIAN_MS} and {GOAL_WORST_MS} ms"
    print(f"together: median {median(every):.0f} ms, worst {max(every):.0f} ms; {goals}")
    return 0 if not any(map(math.isnan, every)) else BAD_INPUT


def _tell(outcome: Outcome, seeds: str, *, shrink: bool) -> None:
    scenario, breach = outcome.scenario, outcome.breach
    assert breach is not None
    print(f"seed {scenario.seed}: {breach}")
    if not shrink:
        print(f"digest {outcome.digest}")
        return

    def breaks(kept: Sequence[int]) -> bool:
        again = simulate(scenario.keeping(kept)).breach
        return again is not None and again.name == breach.name

    least = scenario.keeping(shrunk([n for n in scenario.kept if scenario.happenings[n].t <= breach.t], breaks))
    print(f"  {len(least.kept)} of {len(scenario.kept)} happenings are enough:")
    _list(least)
    kept = ",".join(map(str, least.kept)) or "none"
    print(f"  python -m tools.studies simulate {seeds} {scenario.seed}..{scenario.seed} --keep {kept}", flush=True)


def _list(scenario: Scenario) -> None:
    for number, happening in zip(scenario.kept, scenario.happenings, strict=True):
        print(f"  {number}: {happening}")


def _tell_reached(seen: Counter[Triple], *, whole: bool) -> None:
    missing, reasons, found = never_reached(seen)
    print(f"(state, fault, command): {found} of {found + len(missing)} seen")
    for reason, number in reasons.items():
        print(f"  {number} cannot be: {reason}")
    told = missing if whole else missing[:TOLD_MISSING]
    by_pair: dict[tuple[str, str], list[str]] = {}
    for state, code, command in told:
        by_pair.setdefault((state, code), []).append(command)
    for (state, code), commands in by_pair.items():
        print(f"  not seen: {state}, {code}: {', '.join(commands)}")
    if len(told) < len(missing):
        print(f"  and {len(missing) - len(told)} more: --unreached tells all")


def _fresh(for_s: float) -> Iterable[int]:
    """Seeds from the system's randomness, each told, for so many seconds of processor time."""
    begun = time.process_time()
    first = secrets.randbelow(SEEDS_MOST - (1 << 32))
    print(f"fresh seeds from {first} on", flush=True)
    seed = first
    while time.process_time() - begun < for_s:
        yield seed
        seed += 1


def _seeds(text: str) -> range:
    first, _, last = text.partition("..")
    try:
        found = range(int(first), int(last or first) + 1)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be A..B, such as 0..99, got {text}") from None
    if not found or found[0] < 0:
        raise argparse.ArgumentTypeError(f"must be A..B with A no larger than B and none negative, got {text}")
    return found


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return () if text == "none" else tuple(map(int, text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be numbers with commas between, or none, got {text}") from None
