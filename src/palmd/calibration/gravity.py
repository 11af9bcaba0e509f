"""Finds gravity in the plane and the error of the arm's yaw, with a ball or cylinder that you let roll down the palms.

Needs a running daemon. Arms the arm if necessary, and then stops it at the end; the palms move to one slope after the
other, where you let it roll.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, dataclass

from palmd.bus.command_client import CommandClient
from palmd.bus.link import COMMAND, PUBLISH, add_key, credentials
from palmd.bus.subscriber import Subscriber
from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, store
from palmd.calibration.linkage import adept_arm, arm_base, changed, found, lines, palm_base_in_arm
from palmd.calibration.rolling_fit import (
    INERTIA,
    MIN_ROLLS_PER_PALM,
    Acceleration,
    GravityFit,
    RollerKind,
    TooFewRollsError,
    causes,
    fit_gravity,
    slope,
)
from palmd.calibration.rolling_session import RollingSession, slopes_within
from palmd.config.two_palms import Config
from palmd.console.arguments import between, whole_between
from palmd.console.configured import with_flat_palms
from palmd.console.errors import RIG_FAILED, as_cli_error
from palmd.harness.processes import StopRequest
from palmd.quantities import EVENTS, INFO

FORMAT = 1
_MAX_GRAVITY_M_S2 = 9.84
_MAX_SCATTER = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the configuration that the daemon runs with, palmd.yaml")
    add = parser.add_argument
    add("--roller", choices=INERTIA, default="ball", help="what rolls; a cylinder must be solid (default: %(default)s)")
    add("--rolls", type=whole_between(MIN_ROLLS_PER_PALM, 1000), default=40, metavar="N",
        help="on each steep slope, a third of it on each gentle one (default: %(default)s)")  # fmt: skip
    add("--clear", type=between(0.2, 30.0, " s"), default=3.0, metavar="S",
        help="how long both pads must be free before the palms move (default: %(default)g)")  # fmt: skip
    add("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
    add("--listen", metavar="ADDRESS", help=f"where it publishes (default: as configured, {PUBLISH})")
    add_output(parser, "gravity.yaml")
    add_key(parser)


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before everything is measured; CliError if the daemon refuses or the rolls do not suffice."""
    config = with_flat_palms(arguments.config, "what rolls down a palm")
    folder = result_folder(arguments)
    key = credentials(arguments)
    command, publish = arguments.address or config.bus.command, arguments.listen or config.bus.publish
    slopes = list(slopes_within(config.limits, arguments.rolls))
    with (
        StopRequest() as stop,
        CommandClient(command, key=key) as client,
        Subscriber(publish, topics=(EVENTS.name, INFO.name), key=key) as subscriber,
    ):
        client.ask("status")
        session = RollingSession(config, client, subscriber, stop, arguments.clear)
        session.begin(slopes)
        try:
            for each in slopes:
                session.collect(each)
            session.is_complete = True
        finally:
            session.end()
    with as_cli_error(TooFewRollsError, status=RIG_FAILED, before="gravity: "):
        fit = fit_gravity(session.rolls, arguments.roller)
    kind = arguments.roller
    report(table(fit, kind, session.too_short, session.not_smooth), remarks(fit, kind))
    settings = proposed_settings(fit, config)
    numbers = {
        "gravity_m_s2": fit.g,
        "gravity_sd_m_s2": fit.g_sd,
        "yaw_error_deg": math.degrees(fit.delta),
        "yaw_error_sd_deg": math.degrees(fit.delta_sd),
        "rolling_resistance": fit.resistance,
        "rolling_resistance_sd": fit.resistance_sd,
        "scatter": fit.scatter,
    }
    results = plain(numbers) | {"slopes": [plain(asdict(row)) for row in by_slope(fit, kind)]}
    section = changed(config, settings["rig"], settings["arm"])
    header = {"palmd_gravity_calibration": FORMAT}
    store(folder / "gravity.yaml", document(header, section, settings, results, {"roller": kind}))
    print(f"{arguments.config}: write in these sections:\n{lines(settings)}")
    return 0


def table(fit: GravityFit, kind: RollerKind, too_short: int, not_smooth: int) -> str:
    """The result as text for a terminal."""
    counts = causes(too_short, not_smooth, fit.inconsistent)
    reasons = ", ".join(f"{count} {cause}" for cause, count in counts.items())
    rows = {
        "gravity": found(fit.g, fit.g_sd, "m/s² in the plane", 4),
        "yaw": f"error {found(math.degrees(fit.delta), math.degrees(fit.delta_sd), '°', 3)}",
        "rolling": f"resistance {found(fit.resistance, fit.resistance_sd, '', 5)}",
    }
    head = f"gravity: {len(fit.used)} rolls of a {kind}" + (f"; left out: {reasons}" if reasons else "")
    return "\n".join([head, *(f"  {what:8} {text}" for what, text in rows.items()), *map(_row, by_slope(fit, kind))])


@dataclass(frozen=True, slots=True)
class SlopeResult:
    """The rolls on one slope: mean acceleration, and its residual with 1σ (m/s²)."""

    pad: int
    slope_deg: float
    rolls: int
    mean_m_s2: float
    left_m_s2: float
    left_sd_m_s2: float


def by_slope(fit: GravityFit, kind: RollerKind) -> list[SlopeResult]:
    """Residuals of the fit by slope, gentle ones first."""
    groups: dict[tuple[int, float], list[Acceleration]] = {}
    for roll in fit.used:
        groups.setdefault((roll.pad, round(math.degrees(slope(roll.pad, roll.phi)), 1)), []).append(roll)
    rows = []
    for (pad, slope_deg), rolls in sorted(groups.items()):
        weights = [roll.a_sd**-2 for roll in rolls]
        mean = sum(w * roll.a for w, roll in zip(weights, rolls, strict=True)) / sum(weights)
        predicted = fit.acceleration(rolls[0].phi, kind)
        rows.append(SlopeResult(pad, slope_deg, len(rolls), mean, mean - predicted, sum(weights) ** -0.5))
    return rows


def _row(row: SlopeResult) -> str:
    residual = found(row.left_m_s2, row.left_sd_m_s2, "m/s² residual", 4)
    return f"  palm {row.pad} {row.slope_deg:6.1f}°  {row.rolls:3} rolls  {row.mean_m_s2:8.4f} m/s², {residual}"


def remarks(fit: GravityFit, kind: RollerKind) -> list[str]:
    """Warnings for the operator."""
    warnings = []
    if fit.g - 3.0 * fit.g_sd > _MAX_GRAVITY_M_S2:
        warnings.append(
            f"gravity: {fit.g:.3f} m/s² is more than possible: check the pads' counts_per_mm, and that it is a {kind}"
        )
    if fit.resistance < -3.0 * fit.resistance_sd:
        warnings.append("gravity: a negative resistance: it was pushed, it slipped, or a pad's scale is not linear")
    if fit.scatter > _MAX_SCATTER:
        warnings.append(
            f"gravity: the rolls scatter {fit.scatter:.1f} times as much as expected: is it round and clean?"
        )
    return warnings


def proposed_settings(fit: GravityFit, config: Config) -> dict[str, dict[str, float]]:
    """Settings for the configuration, by section: the yaw is rotated about the palms' base, which stays."""
    yaw_deg = round(adept_arm(config).base_yaw_deg + math.degrees(fit.delta), 4)
    return {
        "rig": {"gravity_m_s2": round(fit.g, 4)},
        "arm": {**arm_base(config, palm_base_in_arm(config), yaw_deg), "base_yaw_deg": yaw_deg},
    }
