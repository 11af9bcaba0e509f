"""Daemon and rig in one process in virtual time: random faults, and invariants that must hold nevertheless.

One seed draws plan, faults, commands of several clients, damaged bytes, stalls, slow helpers, clock steps and restarts;
invariants are checked at every tick. A run that breaks one is reduced to the events that matter and printed as one
command that repeats it bit for bit. Most runs have a light rig and a trivial observer. The last lines count runs,
simulated hours, broken invariants and what occurred. Exit status 1 if an invariant was broken.
"""

from __future__ import annotations

import argparse
import secrets
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NoReturn

from palmd.cli import INTERRUPTED
from palmd.console.arguments import count, seconds
from palmd.console.errors import BAD_INPUT
from palmd.console.progress import Progress
from tools.studies import runs
from tools.studies.harness import terminable
from tools.studies.simulation.run import Outcome, simulate
from tools.studies.simulation.scenario import RATE_HZ, Scenario, coarsened, drawn

SEEDS_MOST = 1 << 63


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    add = parser.add_argument
    which = parser.add_mutually_exclusive_group().add_argument
    which("--seeds", type=_seeds, metavar="A..B", help="seeds from A to B, both included")
    which("--fresh", type=seconds, default=60.0, metavar="S",
        help="new random seeds for so many seconds of processor time; default: %(default)g")  # fmt: skip
    add("--coarse", action="store_true", help="longer steps and adapters that deliver each 4 ms, for more hours")
    add("--rate", type=float, default=RATE_HZ, metavar="HZ", help="rate of the daemon's loop; default: %(default)g")
    add("--jobs", type=count, default=1, metavar="J", help="with --seeds: number of processes; default: %(default)s")
    add("--keep", type=_numbers, metavar="N,N…", help="only these events of a single seed")
    add("--list", action="store_true", help="print the events of a single seed")


def conduct(arguments: argparse.Namespace) -> int:
    """Run the study; status 1 if an invariant was broken; usage error for --keep or --list with several seeds."""
    given: range | None = arguments.seeds
    single = given is not None and len(given) == 1
    if (arguments.keep is not None or arguments.list) and not single:
        print("--keep and --list are for one seed: --seeds A..A", file=sys.stderr)
        return BAD_INPUT
    simulated_s, spent, done, failed, status = 0.0, 0.0, 0, 0, 0
    sometimes: Counter[str] = Counter()
    with Progress("simulate", len(given or ()), "runs") as progress:
        try:
            for outcome, took_s in _outcomes(_fresh(arguments.fresh) if given is None else given, arguments):
                done, simulated_s, spent = done + 1, simulated_s + outcome.simulated_s, spent + took_s
                sometimes += outcome.sometimes
                if arguments.list:
                    _list(outcome.scenario)
                if outcome.breach is not None:
                    failed += 1
                    how = "--coarse " * arguments.coarse + f"--rate {arguments.rate:g} " * (arguments.rate != RATE_HZ)
                    _report_breach(outcome, f"{how}--seeds", shrink=arguments.keep is None)
                elif single:
                    print(f"seed {outcome.scenario.seed}: every invariant held; digest {outcome.digest}")
                if given is not None:
                    progress.at(done)
        except KeyboardInterrupt:
            status = INTERRUPTED
            print("interrupted; until then:")
    print(
        f"{done} runs, {simulated_s / 3600:.2f} simulated hours, {failed} with a broken invariant; "
        f"{simulated_s / max(spent, 1e-9):.1f} simulated hours per processor hour"
    )
    print(f"sometimes: {', '.join(f'{name} {number}' for name, number in sorted(sometimes.items()))}")
    return BAD_INPUT if failed else status


def _outcomes(seeds: Iterable[int], arguments: argparse.Namespace) -> Iterator[tuple[Outcome, float]]:
    """The outcome of each seed with its processor time (s), in the order of completion; in this process or others."""
    run = partial(_outcome, keep=arguments.keep, coarse=arguments.coarse, rate_hz=arguments.rate)
    if arguments.jobs == 1 or not isinstance(seeds, range):
        yield from map(run, seeds)
        return
    with terminable(), runs.local(arguments.jobs) as executor:
        yield from runs.finished(executor, run, _ended, seeds)


def _outcome(seed: int, *, keep: Sequence[int] | None, coarse: bool, rate_hz: float) -> tuple[Outcome, float]:
    """The outcome of a seed, with the events to `keep` only if given, and the processor time (s)."""
    t_cpu = time.process_time()
    scenario = replace(drawn(seed), rate_hz=rate_hz)
    scenario = coarsened(scenario) if coarse else scenario
    outcome = simulate(scenario if keep is None else scenario.keeping(keep))
    return outcome, time.process_time() - t_cpu


def _ended(seed: int, error: BaseException) -> NoReturn:
    """Raise RuntimeError for a run that raised: a bug of the simulation itself."""
    raise RuntimeError(f"seed {seed}: {error!r}") from error


def _report_breach(outcome: Outcome, seeds: str, *, shrink: bool) -> None:
    scenario, breach = outcome.scenario, outcome.breach
    assert breach is not None
    print(f"seed {scenario.seed}: {breach}")
    if not shrink:
        print(f"digest {outcome.digest}")
        return

    def breaks(kept: Sequence[int]) -> bool:
        again = simulate(scenario.keeping(kept)).breach
        return again is not None and again.name == breach.name

    least = scenario.keeping(shrunk([n for n in scenario.kept if scenario.events[n].t <= breach.t], breaks))
    print(f"  {len(least.kept)} of {len(scenario.kept)} events suffice:")
    _list(least)
    kept = ",".join(map(str, least.kept)) or "none"
    print(f"  python -m tools.studies simulate {seeds} {scenario.seed}..{scenario.seed} --keep {kept}", flush=True)


def _list(scenario: Scenario) -> None:
    for number, event in zip(scenario.kept, scenario.events, strict=True):
        print(f"  {number}: {event}")


def _fresh(for_s: float) -> Iterable[int]:
    """Consecutive seeds from a random first one, which is printed, for so many seconds of processor time."""
    t_cpu = time.process_time()
    first = secrets.randbelow(SEEDS_MOST - (1 << 32))
    print(f"fresh seeds from {first} on", flush=True)
    seed = first
    while time.process_time() - t_cpu < for_s:
        yield seed
        seed += 1


def _seeds(text: str) -> range:
    first, _, last = text.partition("..")
    try:
        found = range(int(first), int(last or first) + 1)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be A..B, such as 0..99, got {text}") from None
    if not found or found[0] < 0:
        raise argparse.ArgumentTypeError(f"must be A..B with 0 ≤ A ≤ B, got {text}")
    return found


def _numbers(text: str) -> tuple[int, ...]:
    try:
        return () if text == "none" else tuple(map(int, text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be numbers separated by commas, or none, got {text}") from None


MOST_TRIES = 200


def shrunk(kept: Sequence[int], breaks: Callable[[Sequence[int]], bool], tries: int = MOST_TRIES) -> list[int]:
    """A minimal part of `kept` that still `breaks`, by Zeller's ddmin.

    Makes at most `tries` tries and returns the part reached by then.
    """
    kept, parts, made = list(kept), 2, 0
    while len(kept) > 1 and made < tries:
        size = max(1, len(kept) // parts)
        for start in range(0, len(kept), size):
            rest = kept[:start] + kept[start + size :]
            made += 1
            if rest and breaks(rest):
                kept, parts = rest, max(parts - 1, 2)
                break
            if made >= tries:
                return kept
        else:
            if size == 1:
                break
            parts = min(2 * parts, len(kept))
    return kept if kept and not breaks([]) else []
