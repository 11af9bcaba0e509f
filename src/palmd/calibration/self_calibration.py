"""Finds the pads' zeros and the arm's yaw from recorded runs with any objects: all runs share the rig.

Each run is reconstructed, and the runs' information about the rig's constants is combined. Constants that the runs do
not determine stay as they are. Nothing moves, and no daemon is needed.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from palmd.aliases import SELF_CALIBRATION, with_former_names
from palmd.calibration.files import add_config, add_output, document, plain, report, result_folder, store
from palmd.calibration.linkage import arm_base, lines, palm_base_in_arm
from palmd.config.arms import ServosConfig
from palmd.config.two_palms import Config, rig_description
from palmd.console.arguments import seed
from palmd.console.configured import configured
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error
from palmd.events import FloatArray
from palmd.model.smoothing import R
from palmd.observer.criticism import RigBelief, criticised
from palmd.observer.reconstruct import reconstruct
from palmd.observer.reconstruction import Reconstruction
from palmd.record import RunError, is_recording
from palmd.record.eventlog import EventLog, LogError, read_log
from palmd.record.run import read_run
from palmd.system.description import RigDescription
from palmd.system.mechanism import PALMS
from palmd.system.rig_constants import RIG_NAMES, RIG_TABLE, describe_rig_errors, determined, shown

FORMAT = 1
Sections = dict[str, dict[str, float]]

# configuration keys that affect the readings of a recording
_READING_KEYS = (
    *(f"rig.{name}" for name in ("gravity_m_s2", "hinge", "base_mm", *(f"palm{n}_length_mm" for n in PALMS))),
    *(f"pads.palm{n}.{name}" for n in PALMS for name in ("axis", "sign", "zero_mm", "counts_per_mm", "length_mm")),
    *(f"arm.{name}" for name in ("base_x_mm", "base_y_mm", "base_yaw_deg")),
)
_MAX_DEVIATION = 4.0  # 1σ of a run


@dataclass(frozen=True, slots=True)
class RigFit:
    """Errors of the constants in `system.rig_constants.RIG_TABLE`, their covariance, and their priors' 1σ."""

    values: FloatArray
    covariance: FloatArray
    priors: FloatArray

    @property
    def sds(self) -> FloatArray:
        """1σ of each constant."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def determined(self) -> npt.NDArray[np.bool_]:
        """Which constants the runs determine."""
        return determined(self.sds, self.priors)

    @property
    def independent_sds(self) -> FloatArray:
        """1σ values whose diagonal covariance bounds the joint covariance; limited to those of the priors."""
        correlation = self.covariance / np.outer(self.sds, self.sds)
        widening = math.sqrt(np.linalg.eigvalsh(correlation)[-1])
        return np.minimum(widening * self.sds, self.priors)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The calibration's arguments."""
    add_config(parser, "the configuration that the runs were recorded with, palmd.yaml")
    add = parser.add_argument
    add("runs", type=Path, nargs="+", metavar="RUN", help="recorded runs (.mcap), or event logs of this rig")
    add("--seed", type=seed, default=0, metavar="N", help="of the blind starts (default: %(default)s)")
    add_output(parser, "self.yaml")


def run(arguments: argparse.Namespace) -> int:
    """Writes nothing before all runs are reconstructed; CliError if one cannot be used, or none is reconstructed."""
    config = configured(arguments.config)
    folder = result_folder(arguments)
    logs = {path: _read(path, arguments.config, config) for path in arguments.runs}
    if len({path.resolve() for path in logs}) < len(arguments.runs):
        raise CliError(BAD_INPUT, "a run is given twice: its information would count twice")
    answers = dict(_reconstructions(logs, rig_description(config), arguments.seed))
    if not answers:
        raise CliError(BAD_INPUT, "self: no run was reconstructed: record longer ones, with more of an object touched")
    fit = fitted(list(answers.values()), rig_description(config))
    report(table(fit, len(answers)), remarks(fit, answers))
    values = proposed_settings(fit, config)
    if not values:
        print(f"{arguments.config}: nothing to write: the runs determine neither a zero, a scale nor the yaw")
        return 0
    header, inputs = {"palmd_self_calibration": FORMAT}, {"runs": [str(path) for path in answers]}
    store(folder / "self.yaml", document(header, applied(config, values), plain(values), _results(fit), inputs))
    print(f"{arguments.config}: write in these sections:\n{lines(values)}")
    return 0


def fitted(answers: Sequence[Reconstruction], rig: RigDescription) -> RigFit:
    """Combine all runs; each constant's prior is widened by how much the runs contradict it, as in a single run."""
    prior_sd = RigBelief.of(rig).described_sd
    runs = [(*(each.rig_by_prior or (each.rig, each.rig_covariance)), each.rig_prior_sd) for each in answers]
    together = combined(runs, prior_sd)
    return combined(runs, criticised(together.values, together.covariance, prior_sd, prior_sd).sd)


def combined(runs: Iterable[tuple[FloatArray, FloatArray, FloatArray]], priors: FloatArray) -> RigFit:
    """Combine the runs: add each posterior's (mean, covariance) information beyond its prior's, and `priors` once.

    Priors have mean zero and nonzero 1σ; the third item of a run is the prior with which it was reconstructed.
    """
    units, own = np.outer(priors, priors), np.eye(len(priors))
    information: FloatArray = own.copy()
    side = np.zeros(len(priors))
    for mean, covariance, prior in runs:
        of_run = np.linalg.inv(covariance / units)
        information += of_run - np.diag((priors / prior) ** 2)
        side += of_run @ (mean / priors)
    together = np.linalg.inv(information)
    return RigFit(priors * (together @ side), together * units, priors)


def table(fit: RigFit, runs: int) -> str:
    """The constants that the runs determine, and the names of the others, as text for a terminal."""
    rows = [
        f"  {constant.subject:26} {shown(constant, value, sd)} {constant.error_text}"
        for constant, value, sd, is_determined in zip(RIG_TABLE, fit.values, fit.sds, fit.determined, strict=True)
        if is_determined
    ]
    undetermined = [
        constant.subject for constant, is_determined in zip(RIG_TABLE, fit.determined, strict=True) if not is_determined
    ]
    return "\n".join(
        [f"self: {runs} run{'s' * (runs > 1)}", *rows, f"  not determined: {', '.join(undetermined) or 'none'}"]
    )


def remarks(fit: RigFit, answers: Mapping[Path, Reconstruction]) -> Iterator[str]:
    """Warnings for the operator: errors that no key can correct, and runs that contradict the others."""
    proposed = np.isin(np.arange(len(fit.values)), [*range(R.ZERO, R.SAGITTA), R.TILT])
    yield from describe_rig_errors(np.where(proposed, 0.0, fit.values), fit.sds, fit.priors, np.zeros_like(fit.sds))
    for path, answer in answers.items():
        for i in np.flatnonzero(fit.determined & (np.abs(answer.rig - fit.values) > _MAX_DEVIATION * answer.rig_sd)):
            value = shown(RIG_TABLE[i], float(answer.rig[i]), float(answer.rig_sd[i]))
            yield f"{path}: alone it gives {value} of {RIG_TABLE[i].subject}: was something changed between the runs?"


def proposed_settings(fit: RigFit, config: Config) -> Sections:
    """Settings for the configuration, by section, of the constants that the runs determine.

    A reading ZERO + (1 + SCALE) s becomes s with the zero (zero − ZERO)/(1 + SCALE) and a scale larger by 1 + SCALE;
    the palms are steeper by TILT if the yaw is, rotated about the palms' base, which stays.
    """
    errors, sds = np.where(fit.determined, fit.values, 0.0), fit.independent_sds
    sections: Sections = {}
    for palm, pad in zip(PALMS, config.pads.each(), strict=True):
        zero, scale = R.ZERO + palm - 1, R.SCALE + palm - 1
        stretch = 1.0 + float(errors[scale])
        values = {}
        if fit.determined[zero]:
            values["zero_sd_mm"] = _rounded_up(sds[zero] * 1e3)
        if fit.determined[scale]:
            values |= {"counts_per_mm": round(pad.counts_per_mm * stretch, 4), "scale_sd": _rounded_up(sds[scale])}
        if values:
            zero_mm = (pad.zero_mm - float(errors[zero]) * 1e3) / stretch
            sections[f"pads.palm{palm}"] = {"zero_mm": round(zero_mm, 3)} | values
    if fit.determined[R.TILT]:
        gravity_sd_deg = min(_rounded_up(math.degrees(sds[R.TILT])), config.rig.gravity_sd_deg)
        sections["rig"] = {"gravity_sd_deg": gravity_sd_deg}
        if isinstance(config.arm, ServosConfig):
            for palm, servo in zip(PALMS, config.arm.servos, strict=True):
                centre_deg = round(servo.centre_deg + math.degrees(errors[R.TILT]), 4)
                sections[f"arm.servo{palm}"] = {"centre_deg": centre_deg}
        else:
            yaw_deg = round(config.arm.base_yaw_deg + math.degrees(errors[R.TILT]), 4)
            sections["arm"] = {**arm_base(config, palm_base_in_arm(config), yaw_deg), "base_yaw_deg": yaw_deg}
    return sections


def applied(config: Config, sections: Sections) -> Config:
    """The configuration with these values."""
    changed = config.model_dump(mode="json")
    for name, values in sections.items():
        reduce(lambda block, key: block[key], name.split("."), changed).update(values)
    return Config.model_validate(changed)


def _results(fit: RigFit) -> dict[str, Any]:
    found = zip(
        RIG_NAMES, fit.values.tolist(), fit.sds.tolist(), fit.priors.tolist(), fit.determined.tolist(), strict=True
    )
    return {
        name: with_former_names(
            SELF_CALIBRATION, {"value": value, "sd": sd, "prior_sd": prior, "determined": is_determined}
        )
        for name, value, sd, prior, is_determined in found
    }


def _rounded_up(sd: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(sd)) - 1)
    return round(math.ceil(sd / unit) * unit, 9)


def _read(path: Path, config_path: Path, config: Config) -> EventLog:
    """A run as an event log; CliError if it cannot be used, or was recorded with another configuration."""
    with as_cli_error(LogError, RunError):
        recording = read_run(path) if is_recording(path) else None
        log = read_log(path) if recording is None else recording.event_log()
    recorded = _reading_description(log.rig) if recording is None else _reading_settings(recording.config)
    configured = _reading_description(rig_description(config)) if recording is None else _reading_settings(config)
    for key, value in recorded.items():
        if value != configured[key]:
            raise CliError(
                BAD_INPUT,
                f"{path}: was recorded with {key} {value}, but {config_path} has {configured[key]}: use the"
                " configuration of the recording, or leave the run out",
            )
    return log


def _reading_settings(config: Config) -> dict[str, object]:
    return {key: reduce(getattr, key.split("."), config) for key in _READING_KEYS}


def _reading_description(rig: RigDescription) -> dict[str, object]:
    """What event log and configuration both state about the rig, except zeros, scales and yaw."""
    lengths_m = {f"rig.palm{PALMS[0]}_length_mm": rig.palm1_length}
    lengths_m |= {f"pads.palm{palm}.length_mm": pad.length for palm, pad in zip(PALMS, rig.pads, strict=True)}
    lengths_mm = {key: round(length * 1e3, 6) for key, length in lengths_m.items()}
    return {"rig.gravity_m_s2": rig.gravity, "rig.hinge": rig.hinge, **lengths_mm}


def _reconstructions(
    logs: Mapping[Path, EventLog], rig: RigDescription, seed: int
) -> Iterator[tuple[Path, Reconstruction]]:
    """The runs that can be reconstructed; each result is reported on standard error."""
    for path, log in logs.items():
        answer = reconstruct(log.events, log.rig.known_as(rig), seed)
        for note in log.notes:
            print(note, file=sys.stderr)
        print(f"{path}: {'reconstructed' if answer.converged else f'left out: {answer.reason}'}", file=sys.stderr)
        if answer.converged:
            yield path, answer
