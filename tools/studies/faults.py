"""Every fault injected into the emulated rig, with real processes: the reaction, and the time to standstill.

The runs are recorded, and `palmd why` is asked about each recording. Columns: expected and observed state and faults;
median time until an expected fault was reported; median and worst time to standstill, with the goal (ms); answers of
`palmd why`, and how many are right; deviations. Exit status 1 if a row deviates, or if fewer than 95 % of the answers
are right. The time to standstill does not affect the status, since it depends on the machine as well.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from palmd.config.pads import EvdevConfig
from palmd.config.two_palms import Config, PadsConfig
from palmd.console.arguments import count, seed
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.progress import Progress
from palmd.console.shipped import shipped
from palmd.rig.fault_injection import PADS
from palmd.rig.imperfections import perfect
from palmd.system.mechanism import PALMS
from palmd.yamlfile import load_config
from tools.studies.fault_processes import FaultProcesses
from tools.studies.fault_reaction import Reaction, all_as_promised, as_line, differences, summary, table
from tools.studies.fault_rows import INPUT_ROWS, NAMES, ROWS, SERVO_ROWS, STRIP_ROWS, FaultRow
from tools.studies.harness import ROWS as FILE
from tools.studies.harness import terminable, writable, write

PLAN = "plans/lively.yaml"
RECORDINGS = "recordings"
STARVED_TRIES = 3  # tries of a row that deviates while the machine delayed the rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The study's arguments."""
    add = parser.add_argument
    add("--rig", choices=RIGS, default="adept",
        help="an arm and VersaPads, or servos with strips or input devices (default: %(default)s)")  # fmt: skip
    add("--only", nargs="+", metavar="NAME", help=f"only these rows; with an arm there are {', '.join(NAMES)}")
    add("--times", type=count, default=1, metavar="N", help="provocations of each row (default: %(default)s)")
    add("--seed", type=seed, default=3, help="seed of object and noise (default: %(default)s)")
    add("-o", "--output", type=Path, default=Path("faults"), metavar="FOLDER",
        help=f"folder for {FILE}, which is overwritten, and {RECORDINGS} (default: %(default)s)")  # fmt: skip


def conduct(arguments: argparse.Namespace) -> int:
    """Run the campaign; raises CliError if rig or daemon do not start or the palms do not start to move."""
    kind = RIGS[arguments.rig]
    rows = [row for row in kind.rows if arguments.only is None or row.name in arguments.only]
    if unknown := set(arguments.only or ()) - {row.name for row in rows}:
        names = ", ".join(row.name for row in kind.rows)
        raise CliError(BAD_INPUT, f"no row {', '.join(sorted(unknown))}; with --rig {arguments.rig} there are {names}")
    results: list[tuple[FaultRow, Sequence[Reaction]]] = []
    with terminable(), ExitStack() as stack:
        stream = writable(stack, arguments.output / FILE)
        campaign = stack.enter_context(_Campaign(kind, arguments.seed, (arguments.output / RECORDINGS).absolute()))
        progress = stack.enter_context(Progress("faults", len(rows) * arguments.times, "provocations"))
        for row in rows:
            reactions: list[Reaction] = []
            results.append((row, reactions))
            for _ in range(arguments.times):
                reactions.append(campaign.provoke(row))
                write(stream, [as_line(row, reactions[-1])])
                progress.at(sum(len(some) for _, some in results))
    print(table(results))
    print(summary(results))
    print(f"written: {arguments.output / FILE}")
    return 0 if all_as_promised(results) else BAD_INPUT


@dataclass(frozen=True, slots=True)
class RigKind:
    """A rig for the campaign: name of its shipped configuration, its rows, and other pads, if any."""

    shipped: str
    rows: tuple[FaultRow, ...]
    pads: PadsConfig | None = None

    def config(self) -> Config:
        """The shipped configuration with these pads."""
        config = load_config(shipped(self.shipped))
        return config if self.pads is None else config.model_copy(update={"pads": self.pads})


def _input_devices() -> PadsConfig:
    pads = {f"palm{palm}": EvdevConfig(kind="evdev", port=pad, zero_mm=0.0, counts_per_mm=20.0)
            for palm, pad in zip(PALMS, PADS, strict=True)}  # fmt: skip
    return PadsConfig(**pads)


RIGS = {
    "adept": RigKind("demo.yaml", ROWS),
    "tabletop": RigKind("tabletop.yaml", (*STRIP_ROWS, *SERVO_ROWS)),
    "input": RigKind("tabletop.yaml", INPUT_ROWS, _input_devices()),
}


class _Campaign(ExitStack):
    """Creates the processes when a row needs them, and new ones when they have become unusable."""

    def __init__(self, kind: RigKind, seed: int, runs: Path) -> None:
        super().__init__()
        self._kind, self._seed, self._runs = kind, seed, runs
        self._processes: FaultProcesses | None = None

    def provoke(self, row: FaultRow) -> Reaction:
        """One provocation, repeated if the row deviates while the machine delayed the rig."""
        for _ in range(STARVED_TRIES):
            reaction = self._once(row)
            if not (reaction.starved and differences(row, reaction)):
                break
            print(f"{row.name}: the machine delayed the rig; trying again", file=sys.stderr)
        return reaction

    def _once(self, row: FaultRow) -> Reaction:
        if self._processes is None:
            folder = Path(self.enter_context(tempfile.TemporaryDirectory(prefix="palmd-faults-")))
            config = perfect(self._kind.config()).model_copy(update={"plan": shipped(PLAN)})
            self._processes = self.enter_context(FaultProcesses(folder, config, self._seed, self._runs))
        reaction = self._processes.provoke(row)
        if not self._processes.usable:
            self.close()
            self._processes = None
        return reaction
