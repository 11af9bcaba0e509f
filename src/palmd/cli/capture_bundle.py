"""Bundle of a capture: a folder with configuration, calibration, plan, recordings, photos and caliper table."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import yaml

from palmd.config.two_palms import Config
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error
from palmd.record.calipers import TRUTH, CaliperError, Measured, as_csv, read_table

CONFIGURATION, PLAN, RUNS, PHOTOS, CALIBRATION, FINDINGS = (
    "palmd.yaml", "plan.yaml", "runs", "photos", "calibration", "doctor.txt",
)  # fmt: skip
_README = """palmd capture, {kind}.

palmd.yaml    the rig's calibrated configuration; plan.yaml: the motion
calibration/  results of the calibration with cylinders; doctor.txt: findings before it
runs/         one recording of each object; photos/: put the photos named in truth.csv here
truth.csv     measurements by calipers and scales

palmd reconstruct . -o result.json    estimates each object and compares it with truth.csv
"""


class Recorded(NamedTuple):
    """A recorded object: number, name, and path of the recording within the bundle."""

    number: int
    name: str
    run: str


class Bundle:
    """A bundle folder and the measurements in it; made by `new` or `resumed`.

    Each result is written as soon as it exists, so that a capture that ends early can be resumed.
    """

    def __init__(self, folder: Path, rows: Iterable[Measured] = ()) -> None:
        self.folder = folder
        self._rows = list(rows)

    @classmethod
    def new(cls, folder: Path) -> Self:
        """A new bundle; CliError if the folder is not empty or cannot be created."""
        try:
            if folder.exists() and any(folder.iterdir()):
                raise CliError(BAD_INPUT, f"{folder} is not empty: name another folder with -o")
            for name in (RUNS, PHOTOS):
                (folder / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CliError(BAD_INPUT, f"{folder}: {error.strerror}") from None
        return cls(folder)

    @classmethod
    def resumed(cls, folder: Path) -> Self:
        """The bundle of a capture that ended early; CliError if there is none, or it ended before the calibration."""
        bundle = cls(folder)
        if not bundle.calibrated:
            raise CliError(BAD_INPUT, f"{folder}: has no {CONFIGURATION}, so the pads are not calibrated: begin again")
        if not (folder / RUNS).is_dir():
            raise CliError(BAD_INPUT, f"{folder}: has no folder {RUNS}, so it is no bundle of a capture")
        with as_cli_error(CaliperError):
            return cls(folder, read_table(folder) if (folder / TRUTH).exists() else ())

    @property
    def calibrated(self) -> bool:
        """Whether the calibration is complete."""
        return (self.folder / CONFIGURATION).is_file()

    @property
    def recorded(self) -> list[Recorded]:
        """The recorded objects in the order of their numbers."""
        found = (re.fullmatch(r"(\d+)-(.+)\.mcap", path.name) for path in (self.folder / RUNS).glob("*.mcap"))
        return sorted(Recorded(int(each[1]), each[2], f"{RUNS}/{each[0]}") for each in found if each)

    @property
    def unmeasured(self) -> list[Recorded]:
        """The recorded objects without caliper measurements."""
        measured = {row.run for row in self._rows}
        return [each for each in self.recorded if each.run not in measured]

    @property
    def calibration(self) -> Path:
        """Folder of the calibration results."""
        return self.folder / CALIBRATION

    def note_findings(self, lines: Sequence[str]) -> None:
        """Store doctor's findings."""
        (self.folder / FINDINGS).write_text("\n".join(lines) + "\n", encoding="utf-8")

    def take_run(self, path: Path, name: str) -> str:
        """Move a recording into the bundle, named after the object; return its path within the bundle."""
        within = Path(RUNS) / f"{name}.mcap"
        shutil.move(path, self.folder / within)
        return str(within)

    def begin(self, config: Config, plan: Path, *, emulated: bool) -> None:
        """Write plan, README and, last, the calibrated configuration."""
        shutil.copyfile(plan, self.folder / PLAN)
        kind = "emulated rig, its own truth in place of calipers" if emulated else "measured by hand"
        (self.folder / "README").write_text(_README.format(kind=kind), encoding="utf-8")
        values = written(config) | {"plan": PLAN, "record": {"directory": RUNS}}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
        (self.folder / CONFIGURATION).write_text(text, encoding="utf-8")

    def add(self, row: Measured) -> None:
        """Write an object's measurements into the caliper table."""
        self._rows.append(row)
        (self.folder / TRUTH).write_text(as_csv(self._rows), encoding="utf-8")

    def pack(self) -> Path:
        """Create a zip file of the bundle beside it."""
        return Path(shutil.make_archive(str(self.folder), "zip", self.folder.parent, self.folder.name))


def written(config: Config) -> dict[str, Any]:
    """A configuration as in a file, without defaults."""
    values: dict[str, Any] = config.model_dump(mode="json", exclude_unset=True)
    return values


def with_pads(config: Config, settings: Mapping[str, Mapping[str, Any]]) -> Config:
    """Return the configuration with a calibration's settings for each palm."""
    values = written(config)
    for palm, new in settings.items():
        values["pads"][palm] |= new
    return Config.model_validate(values)
