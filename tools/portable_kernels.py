"""Compiles all kernels for any processor of a level, x86-64-v3 by default, into a folder that goes into a wheel.

`palmd.cli.shipped_kernels` puts them into the cache of a machine without a compiler.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from palmd.cli import build as build_command
from palmd.cli.shipped_kernels import INDEX
from palmd.model import building, compiled

LEVEL, NEEDS = "x86-64-v3", ("AVX2", "FMA3")
_build = building.build


def kernels(folder: Path) -> Path:
    """Makes the folder; takes minutes. Raises RuntimeError without a compiler."""
    folder.mkdir(parents=True, exist_ok=True)
    flags = (f"-march={LEVEL}", *compiled.FLAGS[1:])
    compiled.FLAGS = building.FLAGS = flags
    building.build = _noting
    with tempfile.TemporaryDirectory(prefix="palmd-kernels-") as cache:
        os.environ["XDG_CACHE_HOME"] = cache
        build_command.run(_Everything())
        made = Path(cache) / "palmd"
        libraries = []
        for path in sorted(made.glob("*.written")):
            told: dict[str, Any] = json.loads(path.read_bytes())
            note = made / told["note"]
            shutil.copyfile(note, folder / note.name)
            library = json.loads(note.read_bytes())["library"]
            shutil.copyfile(made / library, folder / library)
            libraries.append(told)
    if not libraries:
        raise RuntimeError("no kernels were compiled: there is no C compiler")
    index = {"needs": NEEDS, "level": LEVEL, "libraries": libraries}
    (folder / INDEX).write_text(json.dumps(index, indent=1), encoding="utf-8")
    return folder


class _Everything:
    """The arguments of `palmd doctor build --all`."""

    config, all = None, True


def _noting(name: str, made: Sequence[Any], written: Sequence[Path], note: Path) -> bool:
    """As `building.build`; what a library is made of is kept beside it."""
    done = _build(name, made, written, note)
    package = Path(compiled.__file__).parent
    files = [str(path.relative_to(package)) for path in written]
    told = {"name": name, "written": files, "note": note.name}
    note.with_suffix(".written").write_text(json.dumps(told), encoding="utf-8")
    return done


if __name__ == "__main__":
    print(kernels(Path(sys.argv[1])))
