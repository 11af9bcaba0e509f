"""Characterises a touchpad by a marble that you roll over it, slowly and fast, lifting it now and then."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, write
from palmd.calibration.pad_characteristic import AxisCharacteristic, PadCharacteristic, TooFewReportsError, characterise
from palmd.config.pads import PadConfig
from palmd.console.arguments import between
from palmd.console.configured import configured
from palmd.console.errors import RIG_FAILED, CliError, as_cli_error, writing
from palmd.console.extras import drawing
from palmd.console.progress import Progress
from palmd.devices.pad import PadReport
from palmd.devices.padlistener import PadListener
from palmd.devices.port import PortUnavailableError, PortWaiter
from palmd.system.mechanism import PALMS

FIRST_TOUCH_S = 15.0
"""Longest time that the pad may remain untouched at the beginning."""
FORMAT = 1

_LOOK_S = 0.1
_SUSPICIOUS_SHARE = 0.01
_LEAST_NOISE_MM = 0.001


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the rig's configuration, palmd.yaml")
    add = parser.add_argument
    add("--characterise", action="store_true", help=argparse.SUPPRESS)  # kept for compatibility
    add("--pad", type=int, choices=PALMS, required=True, help="of which palm")
    add("--seconds", type=between(2.0, 600.0, " s"), default=20.0, metavar="S",
        help="from the first touch (default: %(default)s)")  # fmt: skip
    add_output(parser, "padN.yaml and padN.svg")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before the pad is measured; CliError if the input is wrong or the reports do not suffice."""
    name = f"pad{arguments.pad}"
    config = configured(arguments.config).pads.of(arguments.pad)
    folder = result_folder(arguments)
    packets, counts = _listen(arguments.pad, config, arguments.seconds)
    with as_cli_error(TooFewReportsError, status=RIG_FAILED, before=f"{name}: "):
        found = characterise(packets, counts, config)
    report(table(name, found, config), remarks(name, found, config))
    settings, result = {"noise_mm": noise_mm(found, config)}, folder / f"{name}.yaml"
    header, section = {"palmd_pad_characteristic": FORMAT}, config.model_copy(update=settings)
    write(result, document(header, section, settings, plain(asdict(found)), {"pad": arguments.pad}))
    figure = _draw(packets, found, config, folder / f"{name}.svg")
    print(f"written: {', '.join(map(str, [result, *figure]))}")
    print(f"{arguments.config}: write in pads.palm{arguments.pad}: noise_mm: {settings['noise_mm']:g}")
    return 0


def table(name: str, found: PadCharacteristic, config: PadConfig) -> str:
    """The result as text for a terminal."""
    bands = ", ".join(f"{band.share:.0%} at {band.mean_ms:.1f} ms" for band in found.bands)
    discarded = found.bad_header_bytes + found.bad_data_bytes + found.truncated_bytes
    rows = {
        "interval": f"{found.interval_mean_ms:.1f} ms, sd {found.interval_sd_ms:.1f} ms: {bands}",
        "x": _axis_row(found.x),
        "y": _axis_row(found.y),
        "dead band": f"at most {found.dead_band_counts} counts, {found.dead_band_n:.3f} N",
        "pressure": f"{found.dead_band_counts} to {found.pressure_high}, {found.pressure_levels} levels",
        "discarded": f"{discarded} of {found.received_bytes} bytes ({found.bad_header_bytes} outside a packet, "
        f"{found.bad_data_bytes} illegal, {found.truncated_bytes} cut short)",
    }
    head = f"{name}: {found.reports} reports in {found.seconds:.1f} s, {found.touches} touches, s along {config.axis}"
    return "\n".join([head, *(f"  {what:10} {text}" for what, text in rows.items())])


def remarks(name: str, found: PadCharacteristic, config: PadConfig) -> Iterator[str]:
    """Warnings for the operator."""
    if found.out_of_range > _SUSPICIOUS_SHARE * found.reports:
        yield f"{name}: {found.out_of_range} reports are outside the pad: check zero_mm, sign and counts_per_mm"
    if found.along(config).step_counts > 1:
        yield (
            f"{name}: positions come in steps of {found.along(config).step_counts} counts: the pad is coarser than"
            f" its {config.counts_per_mm:g} counts_per_mm"
        )
    if found.batches > _SUSPICIOUS_SHARE * found.reports:
        yield (
            f"{name}: {found.batches} reads held several reports, so that their times are less certain:"
            " lower the adapter's latency, or close what keeps this machine busy"
        )


def noise_mm(found: PadCharacteristic, config: PadConfig) -> float:
    """The value for the configuration; where rounding hides the noise, its upper limit (1σ)."""
    along = found.along(config)
    return max(round(max(along.noise_mm, along.noise_sd_mm), 3), _LEAST_NOISE_MM)


def _axis_row(axis: AxisCharacteristic) -> str:
    return (
        f"noise {axis.noise_mm:.3f} ± {axis.noise_sd_mm:.3f} mm, step {axis.step_mm:.3f} mm,"
        f" reported from {axis.low_mm:.1f} to {axis.high_mm:.1f} mm"
    )


def _listen(number: int, config: PadConfig, seconds: float) -> tuple[list[PadReport], dict[str, int]]:
    """All reports from the first on, and the driver's counters; CliError if the port fails or there is no touch."""
    name, packets = f"pad{number}", list[PadReport]()
    with (
        as_cli_error(PortUnavailableError, status=RIG_FAILED),
        PadListener(number, config) as listener,
        Progress(name, math.ceil(seconds), "s") as progress,
    ):
        waiter = PortWaiter([listener.port])
        print(f"{name}: roll a marble over the whole pad, slowly and fast; lift it now and then", file=sys.stderr)
        t = time.monotonic()
        t_begin, t_end = math.inf, t + FIRST_TOUCH_S
        while t < t_end:
            waiter.wait(min(t + _LOOK_S, t_end))
            packets += listener.read()
            t = time.monotonic()
            if math.isinf(t_begin) and any(packet.in_use for packet in packets):
                t_begin, t_end = t, t + seconds
            progress.at(int(max(t - t_begin, 0.0)))
    if not math.isinf(t_begin):
        return packets, listener.driver.counts()
    if listener.driver.diagnosis is not None:
        raise CliError(RIG_FAILED, f"{name}: {listener.driver.diagnosis}")
    raise CliError(
        RIG_FAILED,
        f"{name}: no report within {FIRST_TOUCH_S:.0f} s: nobody has touched the pad, or {config.port} is not its port",
    )


def _draw(packets: list[PadReport], found: PadCharacteristic, config: PadConfig, path: Path) -> list[Path]:
    figure = drawing("palmd.calibration.pad_figure")
    if figure is None:
        return []
    with writing(path):
        figure.save(packets, found, config, path)
    return [path]
