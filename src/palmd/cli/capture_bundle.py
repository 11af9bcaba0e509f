"""The bundle of a capture: configuration, calibration, plan, recordings, photos and the caliper table in one folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from palmd.config.two_palms import Config
from palmd.console.errors import BAD_INPUT, CliError
from palmd.record.calipers import TRUTH, Measured, as_csv

CONFIGURATION, PLAN, RUNS, PHOTOS, CALIBRATION, FINDINGS = (
    "palmd.yaml", "plan.yaml", "runs", "photos", "calibration", "doctor.txt",
)  # fmt: skip
_README = """palmd capture: {count} objects, {kind}.

palmd.yaml    the rig as it was calibrated; plan.yaml: the motion
calibration/  what the cylinder has shown; doctor.txt: what was checked before
runs/         one recording for each object; photos/: put the photos here that truth.csv names
truth.csv     what calipers and scales say

palmd reconstruct . -o result.json    estimates each object and compares it with truth.csv
"""


class Bundle:
    """The folder, made anew; CliError for one that has something in it or cannot be made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            if folder.exists() and any(folder.iterdir()):
                raise CliError(BAD_INPUT, f"{folder} is not empty: name another folder with -o")
            for name in (RUNS, PHOTOS):
                (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CliError(BAD_INPUT, f"{folder}: {error.strerror}") from None

    @property
    def calibration(self) -> Path:
        """For what calibrations store."""
        return self.folder / CALIBRATION

    def note_findings(self, lines: Sequence[str]) -> None:
        """What was checked."""
        (self.folder / FINDINGS).write_text("\n".join(lines) + "\n", encoding="utf-8")

    def take_run(self, path: Path, name: str) -> str:
        """A recording into the bundle, named after the object; returns its path within the bundle."""
        within = Path(RUNS) / f"{name}.mcap"
        shutil.move(path, self.folder / within)
        return str(within)

    def finish(self, config: Config, plan: Path, rows: Sequence[Measured], *, emulated: bool) -> None:
        """Everything but what is there already."""
        shutil.copyfile(plan, self.folder / PLAN)
        values = written(config) | {"plan": PLAN, "record": {"directory": RUNS}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        (self.folder / CONFIGURATION).write_text(text, encoding="utf-8")
        (self.folder / TRUTH).write_text(as_csv(rows), encoding="utf-8")
        kind = "emulated rig, its own truth in place of calipers" if emulated else "measured by hand"
        (self.folder / "README").write_text(_README.format(count=len(rows), kind=kind), encoding="utf-8")

    def pack(self) -> Path:
        """The same as one zip file beside it."""
        return Path(shutil.make_archive(str(self.folder), "zip", self.folder.parent, self.folder.name))


def written(config: Config) -> dict[str, Any]:
    """A configuration as it stands in a file: what has its default is left out."""
    values: dict[str, Any] = config.model_dump(mode="json", exclude_unset=True)
    return values


def with_pads(config: Config, settings: Mapping[str, Mapping[str, Any]]) -> Config:
    """The configuration with what a calibration calls for, palm by palm."""
    values = written(config)
    for palm, new in settings.items():
        values["pads"][palm] |= new
    return Config.model_validate(values)
