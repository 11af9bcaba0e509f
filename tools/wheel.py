"""Build a wheel for one platform with kernels compiled for all processors of a level, to run without a compiler.

They are in `palmd/data/kernels`, where `palmd.model.compiled` looks for them if nothing can be compiled.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hatchling.builders.wheel import WheelBuilder

from palmd.model.compiled import NEEDS, shipped_note
from palmd.model.compiler import command

ROOT = Path(__file__).parent.parent
LEVELS = {"x86_64": ("x86-64-v3", ("AVX2", "FMA3"))}
"""By machine: the compiler's name of the level, and NumPy's names of the features that the level below lacks."""


def build_wheel(output: Path, kernels: Path | None) -> Path:
    """Build the wheel in the folder `output`; with a folder of `kernels` it is for this platform only."""
    return Path(next(_Builder(kernels).build(directory=str(output), versions=["standard"])))


class _Builder(WheelBuilder):  # type: ignore[misc]
    def __init__(self, kernels: Path | None) -> None:
        super().__init__(str(ROOT))
        self.kernels = kernels

    def get_default_build_data(self) -> dict[str, Any]:
        data: dict[str, Any] = super().get_default_build_data()
        if self.kernels is None:
            return data
        tag = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
        return data | {"pure_python": False, "tag": tag, "force_include": {str(self.kernels): "palmd/data/kernels"}}


def portable_kernels(folder: Path) -> Path:
    """Compile all kernels for this machine's level into the folder; takes minutes.

    Raises CalledProcessError, or RuntimeError if there is no compiler or no level for this machine.
    """
    level, needs = LEVELS.get(platform.machine(), ("", ()))
    compiler = command()
    if not (level and compiler):
        raise RuntimeError(f"no kernels for {platform.machine()}: {'no level is known' if compiler else 'no compiler'}")
    with tempfile.TemporaryDirectory(prefix="palmd-cache-") as cache:
        environment = os.environ | {"CC": f"{' '.join(compiler)} -march={level}", "CACHE_DIRECTORY": cache}
        build = [sys.executable, "-m", "palmd", "doctor", "build", "--all"]
        subprocess.run(build, env=environment, check=True, stdout=subprocess.DEVNULL)
        collect(Path(cache).glob("*.json"), needs, folder)
    return folder


def collect(notes: Iterable[Path], needs: Iterable[str], folder: Path) -> None:
    """Copy the libraries that these notes of a cache describe into a folder for a wheel."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / NEEDS).write_text(" ".join(needs), encoding="utf-8")
    for note in notes:
        entry = json.loads(note.read_bytes())
        if "sources" not in entry:
            continue  # from an older version
        name = note.stem.rpartition("-")[0]
        shutil.copyfile(note.with_name(entry["library"]), folder / entry["library"])
        shutil.copyfile(note, folder / shipped_note(name, entry["sources"]))
