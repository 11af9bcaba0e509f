"""Soak test: the demo for hours with random fault injection; leaks, drift of lateness, lost messages.

Rig, daemon, recorder and live page run as processes; injected faults, operator commands and visitors are drawn from the
seed. Columns: value and unit of each finding, its goal, and whether it is met (- if it is not judged). Exit status 1 if
a goal is missed. Memory and drift are judged for half an hour or more, punctuality for a minute
or more if the daemon has real-time priority.
"""

from __future__ import annotations

import argparse
import dataclasses
import secrets
import tempfile
import time
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from palmd.console.arguments import seconds, seed
from palmd.console.errors import BAD_INPUT
from palmd.console.progress import Progress
from palmd.console.shipped import shipped
from palmd.jsonvalues import or_none
from palmd.record.recheck import Recheck
from palmd.record.run import RunError, read_run
from palmd.rig.imperfections import perfect
from palmd.yamlfile import load_config
from tools.studies.harness import as_line, terminable, writable, write
from tools.studies.soak_fault_injection import WHAT, ScheduledAct, draw
from tools.studies.soak_findings import (
    SoakFinding,
    all_met,
    between,
    leaks,
    minutes,
    punctuality,
    recorded,
    replayed,
    table,
    without_goal,
)
from tools.studies.soak_processes import PLANS, SoakProcesses

FILE = "soak.jsonl"
JUDGED_FROM_S = 60.0  # shortest soak in which punctuality is judged
REPLAYED_S = 60.0  # part of the recording that is replayed
MINUTE_S = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    add = parser.add_argument
    add("--seconds", type=seconds, default=3600.0, metavar="N", help="duration (default: %(default)g)")
    add("--seed", type=seed, help="seed of object, noise and injected faults; default: a random one, printed")
    add("-o", "--output", type=Path, default=Path("soak"), metavar="FOLDER",
        help=f"folder for {FILE}, which is overwritten, and the recording (default: %(default)s)")  # fmt: skip


def conduct(arguments: argparse.Namespace) -> int:
    """Run the soak; raises CliError if a process does not start or ends, or the palms do not start to move."""
    number = secrets.randbelow(2**31) if arguments.seed is None else arguments.seed
    print(f"seed {number}", flush=True)
    config = perfect(load_config(shipped("demo.yaml"))).model_copy(update={"plan": shipped(PLANS[0])})
    with terminable(), ExitStack() as stack:
        stream = writable(stack, arguments.output / FILE)
        write(stream, [{"row": "soak", "seed": number, "seconds": arguments.seconds}])
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="palmd-soak-")))
        runs = arguments.output.absolute() / "runs"
        processes = SoakProcesses(folder, config, number, runs)
        stack.callback(processes.keep, arguments.output)
        stack.enter_context(processes)
        findings = _soak(processes, draw(np.random.default_rng(number), arguments.seconds), stream, arguments)
        write(stream, [{"row": "finding"} | as_line(finding) for finding in findings])
    print(table(findings))
    print(f"written: {arguments.output / FILE}")
    return 0 if all_met(findings) else BAD_INPUT


def _soak(
    processes: SoakProcesses, schedule: list[ScheduledAct], stream: TextIO, arguments: argparse.Namespace
) -> list[SoakFinding]:
    processes.bring_to_motion()
    t_begin = time.monotonic()
    watch = processes.watch
    watch.seconds.clear()
    _perform(processes, schedule, t_begin, arguments.seconds, stream)
    real_time = "no-realtime" not in watch.last_state["faults"]
    late = punctuality(watch.seconds, goal=real_time and arguments.seconds >= JUDGED_FROM_S)
    slopes = leaks(watch.processes, t_begin, arguments.seconds)
    end, daemon = processes.come_to_rest()
    write(stream, [{"row": "counts", "daemon": or_none(daemon)}])
    return [
        *slopes,
        without_goal("lateness", "real-time priority", float(real_time)),
        *late,
        between(
            "behaviour", "malformed commands sent and not counted", processes.malformed - daemon["bus_malformed"], 0, 0
        ),
        between(
            "behaviour", "visitors not served", len(processes.unserved), 0, 0, why=", ".join(processes.unserved[:4])
        ),
        between("behaviour", "ended ready or held", float(end in ("ready", "hold")), 1, 1, why=f"it ended {end}"),
        *_recording(processes, daemon["bus_published"]),
    ]


def _perform(
    processes: SoakProcesses, schedule: list[ScheduledAct], t_begin: float, duration_s: float, stream: TextIO
) -> None:
    """Perform the schedule and run to the end, with a row in the file each minute."""
    t_minute = t_begin
    left = list(schedule)
    with Progress("soak", round(duration_s), "s") as progress:
        while (t := time.monotonic()) < t_begin + duration_s:
            if left and t >= t_begin + left[0].t_s:
                scheduled = left.pop(0)
                act = scheduled.act
                row = {"row": "doing", "t_s": round(t - t_begin, 3), "what": WHAT[type(act)]}
                write(stream, [row | dataclasses.asdict(act)])
                processes.do(act)
            if t >= t_minute + MINUTE_S:
                t_minute += MINUTE_S
                write(stream, [_minute(processes, t - t_begin)])
            processes.live(min(t + 0.1, t_begin + duration_s))
            progress.at(round(t - t_begin))


def _minute(processes: SoakProcesses, t: float) -> dict[str, Any]:
    watch = processes.watch
    last = minutes(watch.seconds[-61:])
    late = {} if not last else {name: getattr(last[-1], name) for name in ("p50_ms", "p99_ms", "max_ms", "missed")}
    rss = {name: round(series.rss_mb[-1], 1) for name, series in watch.processes.items()}
    return {"row": "minute", "t_s": round(t, 1), "state": watch.state, **late, "rss_mb": rss}


def _recording(processes: SoakProcesses, published: int) -> list[SoakFinding]:
    """Findings about the recording, after daemon and recorder have ended."""
    paths = processes.finish()
    try:
        found = [read_run(path) for path in paths]
        surveys = [run.survey() for run in found]
        findings = recorded(surveys, processes.watch.numbers, published)
        if not found:
            return findings
        ticks = round(found[0].config.loop.rate_hz * REPLAYED_S)
        return findings + replayed(islice(Recheck(found[0]).ticks(), ticks))
    except RunError as error:
        return [between("recording", "readable", 0, 1, 1, why=str(error))]
