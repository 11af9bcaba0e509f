"""Guided first recording of a rig: checks it, calibrates the pads, records objects, and bundles the results.

It runs the daemon and the recorder itself. Each prompt says what to do, and what to do if it fails; Enter accepts the
value in brackets. Keep a hand at the emergency stop. Ctrl-C ends it; after the calibration `--resume` continues it.
`palmd reconstruct BUNDLE` compares the estimates with the caliper measurements.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import math
import re
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import yaml

from palmd.calibration import pads as pads_calibration
from palmd.calibration import standoff as standoff_calibration
from palmd.calibration.cylinder import CylinderError, turning_plan
from palmd.calibration.cylinder_session import progress_line, wait_for_touch, wait_until_removed
from palmd.calibration.pad_standoff import MIN_RATIO
from palmd.cli.build import prepare_kernels
from palmd.cli.capture_bundle import CONFIGURATION, PLAN, Bundle, with_pads
from palmd.cli.init import YES_OR_NO, Prompt, ask, number, or_word
from palmd.config.any_config import BusConfig
from palmd.config.two_palms import Config
from palmd.console.arguments import count, seed
from palmd.console.configured import configured, default_path
from palmd.console.errors import BAD_INPUT, RIG_FAILED, USAGE, CliError, as_cli_error
from palmd.console.notes import say
from palmd.console.shipped import shipped
from palmd.doctor.findings import daemon, findings
from palmd.harness.operator import PlanRun, Status, why
from palmd.harness.processes import StopRequest
from palmd.harness.stack import Stack, not_started
from palmd.motion.check import load_trajectory, motion_limits
from palmd.quantities import BODY
from palmd.record.calipers import Measured, extremes_mm
from palmd.yamlfile import ConfigError

Found = TypeVar("Found")

OBJECTS = 3
CALIPERS_SD_MM = 0.05
"""Standard deviation of a width measured by calipers, including the object's tilt."""
EMULATED_SD_MM = 0.001
"""Standard deviation assigned to the emulated rig's true widths."""
CYLINDERS = ((48.0, 150.0), (30.0, 60.0))
"""Diameter (mm) and mass (g) of the emulated rig's cylinders."""
READY_S = 60.0
PACKED_S = 300.0
ATTEMPTS = 3
"""Attempts at a step on the emulated rig."""
_ON_PALMS = tuple(f"--cylinder={diameter_mm / 2:g},{mass_g:g}" for diameter_mm, mass_g in CYLINDERS)
_OURS = ("configuration", "plan", "pad", "arm")
"""Findings of `palmd doctor` that must be ok; others at most slow palmd down."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("config", nargs="?", type=Path, metavar="CONFIG", help="the rig's configuration (default: the installed one)")
    add("-o", "--output", type=Path, metavar="BUNDLE", help="a new folder (default: capture-DATE-TIME here)")
    add("--plan", type=Path, metavar="PLAN", help="motion plan for each object (default: the configuration's)")
    add(
        "--objects", type=count, default=OBJECTS, metavar="N", help="number of objects to record (default: %(default)s)"
    )
    add("--zip", action="store_true", help="also pack the bundle into BUNDLE.zip")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--resume", type=Path, metavar="BUNDLE", help="continue a capture that ended early")
    which.add_argument("--emulated", action="store_true",
        help="use an emulated rig, which answers the prompts; its truth replaces the calipers")  # fmt: skip
    add("--seed", type=seed, default=0, metavar="N", help="seed of the emulated rig (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Create a bundle; CliError if the input is wrong, the rig fails, or the user gives up."""
    t_start = time.monotonic()
    config, plan, bundle = _resumed(arguments) if arguments.resume else _begun(arguments)
    prepare_kernels(config, say)
    alone = config.model_copy(update={"bus": BusConfig()})
    try:
        with (
            tempfile.TemporaryDirectory(prefix="palmd-capture-") as folder,
            Stack(Path(folder), alone, notify=say) as stack,
        ):
            guide = Guide(stack, alone, plan, bundle, arguments.seed if arguments.emulated else None)
            guide.take(config, arguments.objects)
    except (CliError, KeyboardInterrupt):
        if bundle.calibrated and not arguments.emulated:
            say(f"\nTo continue: palmd record capture --resume {bundle.folder} --objects {arguments.objects}")
        raise
    say(f"took {(time.monotonic() - t_start) / 60.0:.1f} min")
    say(f"next: palmd reconstruct {bundle.folder} -o {bundle.folder}/result.json")
    print(bundle.pack() if arguments.zip else bundle.folder)
    return 0


def _begun(arguments: argparse.Namespace) -> tuple[Config, Path, Bundle]:
    """Return configuration, plan and bundle of a new capture."""
    config = configured(shipped("tabletop.yaml") if arguments.emulated and not arguments.config
                        else default_path(arguments.config))  # fmt: skip
    plan = _plan(arguments.plan or config.plan, config)
    return config, plan, Bundle.new(arguments.output or Path(f"capture-{datetime.datetime.now():%Y%m%d-%H%M%S}"))


def _resumed(arguments: argparse.Namespace) -> tuple[Config, Path, Bundle]:
    """Return configuration, plan and bundle of a capture that ended early."""
    if arguments.config or arguments.output or arguments.plan:
        raise CliError(USAGE, "--resume uses the configuration and plan of the bundle: omit CONFIG, -o and --plan")
    bundle = Bundle.resumed(arguments.resume)
    config = configured(bundle.folder / CONFIGURATION)
    return config, _plan(bundle.folder / PLAN, config), bundle


def _plan(path: Path | None, config: Config) -> Path:
    """Return the plan, which must end and be within the limits; else CliError."""
    if path is None:
        raise CliError(BAD_INPUT, "the configuration names no plan: give one with --plan")
    with as_cli_error(ConfigError):
        load_trajectory(path, motion_limits(config))
    if _read(path).get("repeat") == "forever":
        raise CliError(BAD_INPUT, f"{path}: repeats forever: a capture needs a plan that ends")
    return path


class Guide:
    """Executes the steps with the user at the rig, or on an emulated rig, which has a `seed`."""

    def __init__(self, stack: Stack, config: Config, plan: Path, bundle: Bundle, seed: int | None) -> None:
        self.config = config
        self._stack, self._bundle, self._seed = stack, bundle, seed
        self._plan_path, self._plan = plan, _read(plan)
        self._body: dict[str, Any] = {}

    @property
    def _emulated(self) -> bool:
        return self._seed is not None

    # -- steps ------------------------------------------------------------------------------------------------

    def take(self, own: Config, objects: int) -> None:
        """Execute all steps that the bundle does not contain yet; `own`: see `check`."""
        for each in self._bundle.unmeasured:
            say(f"Object {each.number}, {each.name}, is recorded but not measured.")
            self._bundle.add(self._measured(each.name, each.run))
        rest = range(max((each.number for each in self._bundle.recorded), default=0) + 1, objects + 1)
        if not rest:
            return
        self.check(own)
        if not self._bundle.calibrated:
            self.calibrate()
            self._begin_rig()
        self._begin_daemon()
        for index in rest:
            self.record(index)

    def check(self, own: Config) -> None:
        """Run `palmd doctor` and store its findings; `own` has the address of a daemon that may already run."""
        say("Step 1: check. Nothing moves.")
        if not self._emulated and daemon(own) is not None:
            raise CliError(RIG_FAILED, "a palmd daemon is already running: stop it first (sudo systemctl stop palmd)")
        self._begin_rig(*_ON_PALMS)
        self._retry(self._examine, "fix the findings; each line says how")

    def calibrate(self) -> None:
        """Calibrate both pads with one or two cylinders; the results are stored in the bundle."""
        say("Step 2: calibrate the pads with cylinders. The palms move: hands off, one hand at the emergency stop.")
        first, second = (f"{mm:g}" for mm, _ in CYLINDERS) if self._emulated else ("", "none")
        diameter_mm = self._ask("The cylinder's diameter in mm, measured by a micrometer", first, self._diameter())
        other_mm = self._ask(
            "Diameter of a second cylinder, different by a third or more, or none: then the pads' height over the hinge"
            " line stays unknown", second,
            or_word("none", math.nan, self._diameter(diameter_mm)),
        )  # fmt: skip
        self._begin_daemon()
        arguments = argparse.Namespace(
            config=self._stack.path, radius_mm=diameter_mm / 2, second_radius_mm=other_mm / 2, key=None, curve=False,
            output=self._bundle.calibration, resumes=self._confirm_resume,
        )  # fmt: skip

        attempts = itertools.count()

        def calibrated() -> None:
            if next(attempts) and self._emulated:  # the failed attempt left another cylinder, or none
                self._begin_rig(*_ON_PALMS)
                self._begin_daemon()
            self._until_ready()
            with redirect_stdout(sys.stderr):
                if math.isnan(other_mm):
                    pads_calibration.run(arguments)
                else:
                    standoff_calibration.measure(arguments, partial(self._exchanged, arguments))

        self._retry(calibrated, "clean cylinder and pads, lay the cylinder across both, and remove everything else")
        name = "pads.yaml" if math.isnan(other_mm) else standoff_calibration.FILE
        self.config = with_pads(self.config, _read(self._bundle.calibration / name)["configuration"])
        self._bundle.begin(self.config, self._plan_path, emulated=self._emulated)
        say("The results are used from now on; nothing has to be written by hand.")
        if not self._emulated:
            there = self.config.model_copy(update={"bus": self._stack.bus})
            self._retry(partial(wait_until_removed, arguments, there, "the last cylinder"), "remove the cylinder")

    def _diameter(self, other_mm: float | None = None) -> Callable[[str], float]:
        """Reader of the diameter of a cylinder that the palms can turn and that differs enough from the other one."""

        def read(answer: str) -> float:
            diameter_mm = number(2, 200)(answer)
            if other_mm and max(diameter_mm, other_mm) < MIN_RATIO * min(diameter_mm, other_mm):
                raise ValueError(f"at most {other_mm / MIN_RATIO:.1f} or at least {other_mm * MIN_RATIO:.1f}, or none")
            try:
                turning_plan(diameter_mm * 5e-4, motion_limits(self.config))
            except CylinderError as error:
                raise ValueError(f"one that the palms can turn: {error}") from None
            return diameter_mm

        return read

    def _exchanged(self, arguments: argparse.Namespace, config: Config, cylinder: str) -> None:
        if self._emulated:
            self._stack.ask_rig("new_object")
        else:
            wait_until_removed(arguments, config, cylinder)

    def record(self, index: int) -> None:
        """Record one object during the plan, then ask for its caliper measurements."""
        say(f"Step {2 + index}: object {index}. The palms move: hands off, one hand at the emergency stop.")
        name = self._ask("Its name, one word", f"object-{index}", _word)
        mend = "put the object back across both pads; a lighter or rounder one, or a slower plan, is easier"
        path = self._retry(lambda: self._recorded(name), mend)
        with StopRequest():  # Ctrl-C does not interrupt the copy
            within = self._bundle.take_run(path, f"{index}-{name}")
        self._bundle.add(self._measured(name, within))

    def _measured(self, name: str, path: str) -> Measured:
        if self._emulated:
            largest, smallest = extremes_mm(self._body["h_m"])
            return Measured(name, path, "", largest, smallest, EMULATED_SD_MM, self._body["mass_kg"] * 1e3)
        say(f"Remove {name}. Turn it between the jaws of the calipers, in the plane in which it moved.")
        largest = self._ask("Its largest width in mm", "", number(1, 300))
        smallest = self._ask("Its smallest width in mm", "", number(1, largest))
        mass_g = self._ask("Its mass in g, or unknown", "unknown", or_word("unknown", math.nan, number(0.1, 5000)))
        photo = self._ask("File name in photos/ of a photo with a ruler beside it", f"{name}.jpg")
        return Measured(name, path, photo, largest, smallest, CALIPERS_SD_MM, mass_g)

    # -- the rig ----------------------------------------------------------------------------------------------

    def _begin_rig(self, *what: str) -> None:
        if self._emulated:
            self._stack.start_rig("--seed", str(self._seed), *what)
        self._stack.configure(self.config, self._stack.rig_info or None)

    def _examine(self) -> None:
        found = list(findings(self._stack.path))
        lines = [finding.line() for finding in found]
        say("\n".join(lines))
        self._bundle.note_findings(lines)
        grave = [each for each in found if each.what.startswith(_OURS) and each.verdict in ("missing", "mismatch")]
        if grave:
            raise CliError(RIG_FAILED, "\n".join(each.line() for each in grave))

    def _begin_daemon(self) -> None:
        self._stack.begin_daemon()
        if not self._stack.wait_for_daemon():
            raise not_started(self._stack.children["daemon"])

    def _until_ready(self) -> None:
        """Wait for state ready; resets faults. CliError after `READY_S`."""
        t_end = time.monotonic() + READY_S
        while time.monotonic() < t_end:
            status = self._stack.client.ask("status").get("result") or {}
            if status.get("state") == "ready":
                return
            self._stack.client.ask("reset" if status.get("state") == "fault" else "stop")
            time.sleep(0.5)
        raise CliError(RIG_FAILED, f"not ready within {READY_S:g} s: run palmd doctor to find the cause")

    def _recorded(self, name: str) -> Path:
        """Run the plan once and return its recording."""
        self._until_ready()
        stack = self._stack
        if self._emulated:
            stack.ask_rig("new_object")
        stack.start_recorder()
        with StopRequest() as stop:  # until the recording is packed
            try:
                wait_for_touch(stack.subscriber, stack.bus.publish, stop, name)
                operation = PlanRun(
                    stack.client, self._listen, lambda _status, seconds: f"ended after {seconds:.0f} s",
                    resumes=self._confirm_resume,
                )  # fmt: skip
                operation.run(self._plan, stop, progress_line)
                if stop.made:
                    raise CliError(RIG_FAILED, "stopped by the operator")
            finally:
                paths = stack.recorded(PACKED_S)
        if len(paths) != 1:
            raise CliError(RIG_FAILED, f"the recorder left {len(paths)} recordings instead of one")
        return paths[0]

    def _listen(self, t_end: float) -> None:
        for message in self._stack.subscriber.until(t_end):
            if message.topic == BODY.name:
                self._body = message.fields

    # -- the terminal -----------------------------------------------------------------------------------------

    def _ask(self, text: str, default: str, read: Callable[[str], Any] = str) -> Any:
        return read(default) if self._emulated else ask(Prompt(text, default, read), "capture")

    def _confirm_resume(self, status: Status) -> bool:
        """Whether held palms may move again; CliError if the user says no or presses Ctrl-C."""
        text = f"The palms are held: {why(status)}\nFix the cause, hands off; then continue, yes or no"
        before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a `StopRequest` would wait for the answer
        try:
            answer = self._ask(text, "yes", YES_OR_NO)
        except KeyboardInterrupt:
            answer = "no"
        finally:
            signal.signal(signal.SIGINT, before)
        if answer == "no":
            raise CliError(RIG_FAILED, f"stopped by the user while held: {why(status)}")
        return True

    def _retry(self, step: Callable[[], Found], mend: str) -> Found:
        """Repeat a step until it succeeds; CliError if the user gives up."""
        for attempt in itertools.count(1):
            try:
                return step()
            except CliError as error:
                say(f"Failed: {error}\nWhat to do: {mend}.")
                again = attempt < ATTEMPTS if self._emulated else self._ask("Try again, yes or no", "yes", YES_OR_NO)
                if again not in (True, "yes"):
                    raise
        raise AssertionError  # unreachable


def _read(path: Path) -> dict[str, Any]:
    values: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return values


def _word(text: str) -> str:
    if not re.fullmatch(r"[\w-]{1,40}", text):
        raise ValueError("one word of letters, digits, - and _")
    return text
