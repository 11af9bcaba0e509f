"""Finds the pads' zeros and the arm's yaw from recorded runs, with any objects: the rig is what they share.

Each run is reconstructed, and what it tells of the rig's constants is added up. What the runs do not tell stays as it
is. Nothing moves, and no daemon is needed.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from palmd.calibration.files import plain, provenance, writable, write
from palmd.calibration.linkage import arm_base, lines, palm_base_in_arm
from palmd.calibration.self_fit import RigFit, combined
from palmd.config.arms import ServosConfig
from palmd.config.two_palms import Config, rig_description
from palmd.console.arguments import seed
from palmd.console.configured import configured
from palmd.console.errors import BAD_INPUT, CliError
from palmd.model.smoothing import R
from palmd.observer.criticism import RigBelief, criticised
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.record import RunError, is_recording
from palmd.record.eventlog import EventLog, LogError, read_log
from palmd.record.run import read_run
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS
from palmd.system.rig_constants import RIG_NAMES, RIG_TABLE, describe_rig_errors, shown

FORMAT = 1
Sections = dict[str, dict[str, float]]

# What the readings of a recording depend on, and that its configuration tells.
_READ_WITH = (
    *(f"rig.{name}" for name in ("gravity_m_s2", "hinge", "base_mm", *(f"palm{n}_length_mm" for n in PALMS))),
    *(f"pads.palm{n}.{name}" for n in PALMS for name in ("axis", "sign", "zero_mm", "counts_per_mm", "length_mm")),
    *(f"arm.{name}" for name in ("base_x_mm", "base_y_mm", "base_yaw_deg")),
)
_DISAGREES = 4.0  # one-sigmas of a run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="the configuration that the runs were recorded with, palmd.yaml")
    add("runs", type=Path, nargs="+", metavar="RUN", help="recorded runs (.mcap), or event logs of this rig")
    add("--seed", type=seed, default=0, metavar="N", help="of the blind starts (default: %(default)s)")
    add("-o", "--output", type=Path, metavar="FOLDER",
        help="for self.yaml, which is overwritten (default: calibration/ beside CONFIG)")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before all runs are reconstructed; CliError when one cannot be used, or none tells anything."""
    config = configured(arguments.config)
    folder = writable(arguments.output or arguments.config.parent / "calibration")
    logs = {path: _read(path, arguments.config, config) for path in arguments.runs}
    if len({path.resolve() for path in logs}) < len(arguments.runs):
        raise CliError(BAD_INPUT, "a run is given twice: what it tells would count twice")
    answers = dict(_reconstructed(logs, rig_description(config), arguments.seed))
    if not answers:
        raise CliError(BAD_INPUT, "self: no run was reconstructed: record longer ones, with more of an object touched")
    fit = fitted(list(answers.values()), rig_description(config))
    print(table(fit, len(answers)))
    for remark in remarks(fit, answers):
        print(remark, file=sys.stderr)
    values = called_for(fit, config)
    if not values:
        print(f"{arguments.config}: nothing to write: the runs tell neither a zero, a scale nor the yaw")
        return 0
    result = folder / "self.yaml"
    write(result, document(fit, values, list(answers), config))
    print(f"written: {result}")
    print(f"{arguments.config}: write in these sections:\n{lines(values)}")
    return 0


def fitted(answers: Sequence[Reconstruction], rig: RigDescription) -> RigFit:
    """What all runs tell of the rig; constants are open, as in each run, by how much contradicts their priors."""
    known = RigBelief.of(rig).told
    runs = [(*(each.rig_by_prior or (each.rig, each.rig_covariance)), each.rig_prior_sd) for each in answers]
    together = combined(runs, known)
    return combined(runs, criticised(together.values, together.covariance, known, known).sd)


def table(fit: RigFit, runs: int) -> str:
    """What the runs have told, and what not, in a few lines for a terminal."""
    found = [
        f"  {constant.subject:26} {shown(constant, value, sd)} {constant.error_text}"
        for constant, value, sd, is_told in zip(RIG_TABLE, fit.values, fit.sds, fit.told, strict=True)
        if is_told
    ]
    rest = [constant.subject for constant, is_told in zip(RIG_TABLE, fit.told, strict=True) if not is_told]
    return "\n".join([f"self: {runs} run{'s' * (runs > 1)}", *found, f"  not told: {', '.join(rest) or 'nothing'}"])


def remarks(fit: RigFit, answers: Mapping[Path, Reconstruction]) -> Iterator[str]:
    """What a person should look into: what no key can mend, and runs that contradict the others."""
    proposed = np.isin(np.arange(len(fit.values)), [*range(R.ZERO, R.SAGITTA), R.TILT])
    yield from describe_rig_errors(np.where(proposed, 0.0, fit.values), fit.sds, fit.priors, np.zeros_like(fit.sds))
    for path, answer in answers.items():
        for i in np.flatnonzero(fit.told & (np.abs(answer.rig - fit.values) > _DISAGREES * answer.rig_sd)):
            said = shown(RIG_TABLE[i], float(answer.rig[i]), float(answer.rig_sd[i]))
            yield f"{path}: alone it says {said} of {RIG_TABLE[i].subject}: was something changed between the runs?"


def called_for(fit: RigFit, config: Config) -> Sections:
    """What the configuration should say of what has been told, by section.

    A reading ZERO + (1 + SCALE) s becomes s where zero is (zero − ZERO)/(1 + SCALE) and the scale larger by 1 + SCALE;
    the palms are steeper by TILT where the yaw is, turned about the palms' base, which stays.
    """
    off, sds = np.where(fit.told, fit.values, 0.0), fit.independent_sds
    sections: Sections = {}
    for palm, pad in zip(PALMS, config.pads.each(), strict=True):
        zero, scale = R.ZERO + palm - 1, R.SCALE + palm - 1
        stretch = 1.0 + float(off[scale])
        values = {}
        if fit.told[zero]:
            values["zero_sd_mm"] = _rounded_up(sds[zero] * 1e3)
        if fit.told[scale]:
            values |= {"counts_per_mm": round(pad.counts_per_mm * stretch, 4), "scale_sd": _rounded_up(sds[scale])}
        if values:
            zero_mm = (pad.zero_mm - float(off[zero]) * 1e3) / stretch
            sections[f"pads.palm{palm}"] = {"zero_mm": round(zero_mm, 3)} | values
    if fit.told[R.TILT]:
        gravity_sd_deg = min(_rounded_up(math.degrees(sds[R.TILT])), config.rig.gravity_sd_deg)
        sections["rig"] = {"gravity_sd_deg": gravity_sd_deg}
        if isinstance(config.arm, ServosConfig):
            for palm, servo in zip(PALMS, config.arm.servos, strict=True):
                centre_deg = round(servo.centre_deg + math.degrees(off[R.TILT]), 4)
                sections[f"arm.servo{palm}"] = {"centre_deg": centre_deg}
        else:
            yaw_deg = round(config.arm.base_yaw_deg + math.degrees(off[R.TILT]), 4)
            sections["arm"] = {**arm_base(config, palm_base_in_arm(config), yaw_deg), "base_yaw_deg": yaw_deg}
    return sections


def applied(config: Config, sections: Sections) -> Config:
    """The configuration with these values."""
    changed = config.model_dump(mode="json")
    for name, values in sections.items():
        reduce(lambda block, key: block[key], name.split("."), changed).update(values)
    return Config.model_validate(changed)


def document(fit: RigFit, values: Sections, runs: Sequence[Path], config: Config) -> dict[str, Any]:
    """The stored result; `configuration` holds what it calls for, the hash is of the whole configuration with it."""
    found = zip(RIG_NAMES, fit.values.tolist(), fit.sds.tolist(), fit.priors.tolist(), fit.told.tolist(), strict=True)
    return {
        "palmd_self_calibration": FORMAT,
        **provenance(applied(config, values)),
        "runs": [str(path) for path in runs],
        "configuration": plain(values),
        "found": {
            name: {"value": value, "sd": sd, "prior_sd": prior, "told": is_told}
            for name, value, sd, prior, is_told in found
        },
    }


def _rounded_up(sd: float) -> float:
    """To two digits."""
    unit = 10.0 ** (math.floor(math.log10(sd)) - 1)
    return round(math.ceil(sd / unit) * unit, 9)


def _read(path: Path, config_path: Path, config: Config) -> EventLog:
    """A run as an event log; CliError when it cannot be used, or was not recorded with this configuration's values."""
    try:
        recording = read_run(path) if is_recording(path) else None
        log = read_log(path) if recording is None else recording.event_log()
    except (LogError, RunError) as error:
        raise CliError(BAD_INPUT, str(error)) from None
    theirs = _described(log.rig) if recording is None else _read_with(recording.config)
    ours = _described(rig_description(config)) if recording is None else _read_with(config)
    for key, value in theirs.items():
        if value != ours[key]:
            raise CliError(
                BAD_INPUT,
                f"{path}: was recorded with {key} {value}, and {config_path} says {ours[key]}: give the configuration"
                " that it was recorded with, or leave it out",
            )
    return log


def _read_with(config: Config) -> dict[str, object]:
    return {key: reduce(getattr, key.split("."), config) for key in _READ_WITH}


def _described(rig: RigDescription) -> dict[str, object]:
    """What an event log says of the rig that a configuration says too: nothing of zeros, scales and yaw."""
    lengths_m = {f"rig.palm{PALMS[0]}_length_mm": rig.palm1_length}
    lengths_m |= {f"pads.palm{palm}.length_mm": pad.length for palm, pad in zip(PALMS, rig.pads, strict=True)}
    lengths_mm = {key: round(length * 1e3, 6) for key, length in lengths_m.items()}
    return {"rig.gravity_m_s2": rig.gravity, "rig.hinge": rig.hinge, **lengths_mm}


def _reconstructed(
    logs: Mapping[Path, EventLog], rig: RigDescription, seed: int
) -> Iterator[tuple[Path, Reconstruction]]:
    """Of each run that can be reconstructed; what comes of it is told on standard error."""
    for path, log in logs.items():
        answer = reconstruct(log.events, log.rig.known_as(rig), seed)
        for note in log.notes:
            print(note, file=sys.stderr)
        print(f"{path}: {'reconstructed' if answer.converged else f'left out: {answer.reason}'}", file=sys.stderr)
        if answer.converged:
            yield path, answer
