"""The demo for hours, with random mischief: does anything leak, come later and later, or get lost?

Rig, daemon, recorder and live page run as processes; mischief, operator's commands and visitors are drawn from the
seed. Exit status 1 when a goal is missed. Memory and drift are judged from half an hour on, punctuality from a minute
on and where the daemon has real-time priority.
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
from tools.studies.harness import terminable, writable, write
from tools.studies.soak_fault_injection import Doing, draw
from tools.studies.soak_findings import (
    SoakFinding,
    all_met,
    as_line,
    between,
    leaks,
    minutes,
    punctuality,
    recorded,
    replayed,
    table,
    told,
)
from tools.studies.soak_stand import PLANS, SoakStand

FILE = "soak.jsonl"
JUDGED_FROM_S = 60.0  # for punctuality
REPLAYED_S = 60.0
MINUTE_S = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The bench's arguments."""
    add = parser.add_argument
    add("--seconds", type=seconds, default=3600.0, metavar="N", help="how long (default: %(default)g)")
    add("--seed", type=seed, help="which object, noise and mischief; default: a random one, printed")
    add("-o", "--output", type=Path, default=Path("soak"), metavar="FOLDER",
        help=f"for {FILE}, which is overwritten, and the recording (default: %(default)s)")  # fmt: skip


def conduct(arguments: argparse.Namespace) -> int:
    """Raises CliError when a process does not start, ends, or the palms cannot be brought to move."""
    number = secrets.randbelow(2**31) if arguments.seed is None else arguments.seed
    print(f"seed {number}", flush=True)
    config = perfect(load_config(shipped("demo.yaml"))).model_copy(update={"plan": shipped(PLANS[0])})
    with terminable(), ExitStack() as stack:
        stream = writable(stack, arguments.output / FILE)
        write(stream, [{"row": "soak", "seed": number, "seconds": arguments.seconds}])
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="palmd-soak-")))
        runs = arguments.output.absolute() / "runs"
        stand = SoakStand(folder, runs, config, number)
        stack.callback(stand.keep, arguments.output)
        stack.enter_context(stand)
        findings = _soak(stand, draw(np.random.default_rng(number), arguments.seconds), stream, arguments)
        write(stream, [{"row": "finding"} | as_line(finding) for finding in findings])
    print(table(findings))
    print(f"written: {arguments.output / FILE}")
    return 0 if all_met(findings) else BAD_INPUT


def _soak(stand: SoakStand, doings: list[Doing], stream: TextIO, arguments: argparse.Namespace) -> list[SoakFinding]:
    stand.bring_to_motion()
    t_begin = time.monotonic()
    watch = stand.watch
    watch.seconds.clear()
    _go_through(stand, doings, t_begin, arguments.seconds, stream)
    real_time = "no-realtime" not in watch.told["faults"]
    late = punctuality(watch.seconds, goal=real_time and arguments.seconds >= JUDGED_FROM_S)
    slopes = leaks(watch.processes, t_begin, arguments.seconds)
    end, daemon = stand.come_to_rest()
    write(stream, [{"row": "counts", "daemon": or_none(daemon)}])
    return [
        *slopes,
        told("lateness", "real-time priority", float(real_time)),
        *late,
        between("behaviour", "malformed commands sent and not counted", stand.nonsense - daemon["bus_malformed"], 0, 0),
        between("behaviour", "visitors not served", len(stand.unserved), 0, 0, why=", ".join(stand.unserved[:4])),
        between("behaviour", "ended ready or held", float(end in ("ready", "hold")), 1, 1, why=f"it ended {end}"),
        *_recording(stand, daemon["bus_published"]),
    ]


def _go_through(stand: SoakStand, doings: list[Doing], t_begin: float, lasts_s: float, stream: TextIO) -> None:
    """Live through all doings and to the end, and tell each minute how it goes."""
    t_minute = t_begin
    left = list(doings)
    with Progress("soak", round(lasts_s), "s") as progress:
        while (t := time.monotonic()) < t_begin + lasts_s:
            if left and t >= t_begin + left[0].t_s:
                doing = left.pop(0)
                kind = doing.act.what
                write(
                    stream,
                    [{"row": "doing", "t_s": round(t - t_begin, 3), "what": kind} | dataclasses.asdict(doing.act)],
                )
                stand.do(doing.act)
            if t >= t_minute + MINUTE_S:
                t_minute += MINUTE_S
                write(stream, [_minute(stand, t - t_begin)])
            stand.live(min(t + 0.1, t_begin + lasts_s))
            progress.at(round(t - t_begin))


def _minute(stand: SoakStand, t: float) -> dict[str, Any]:
    watch = stand.watch
    last = minutes(watch.seconds[-61:])
    late = {} if not last else {name: getattr(last[-1], name) for name in ("p50_ms", "p99_ms", "max_ms", "missed")}
    rss = {name: round(series.rss_mb[-1], 1) for name, series in watch.processes.items()}
    return {"row": "minute", "t_s": round(t, 1), "state": watch.state, **late, "rss_mb": rss}


def _recording(stand: SoakStand, published: int) -> list[SoakFinding]:
    """Of the files, once daemon and recorder have ended."""
    paths = stand.finish()
    try:
        found = [read_run(path) for path in paths]
        surveys = [run.survey() for run in found]
        findings = recorded(surveys, stand.watch.numbers, published)
        if not found:
            return findings
        ticks = round(found[0].config.loop.rate_hz * REPLAYED_S)
        return findings + replayed(islice(Recheck(found[0]).ticks(), ticks))
    except RunError as error:
        return [between("recording", "readable", 0, 1, 1, why=str(error))]
