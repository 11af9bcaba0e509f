"""Writes and checks all files for building the tabletop rig, into one folder: `make kit`."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from tools.tabletop import firmware
from tools.tabletop.assembly import PARTS, collisions
from tools.tabletop.drawing import assembly, drawing
from tools.tabletop.geometry import TABLETOP, Tabletop
from tools.tabletop.mesh import Mesh, fits, open_edges, read_stl
from tools.tabletop.mjcf import mjcf
from tools.tabletop.parameters import parameters
from tools.tabletop.parts import as_csv, parts_list
from tools.tabletop.wiring import wiring

FOLDER = Path("build/kit")
PROGRAM = Path(__file__).with_name("palmd-tabletop.scad")
TEXTS: dict[str, Callable[[Tabletop], str]] = {
    "parameters.scad": parameters,
    "drawing.svg": drawing,
    "assembly.svg": assembly,
    "wiring.svg": lambda _geometry: wiring(),
    "parts.csv": lambda _geometry: as_csv(parts_list()),
    "rig.xml": mjcf,
}
"""Files that are written without other programs."""


class KitError(Exception):
    """The geometry cannot be built, or a part fails its checks."""


def changed(settings: list[str]) -> Tabletop:
    """Return the geometry with changed dimensions `NAME=MM`; raises KitError for an invalid name or value."""
    names = {field.name for field in fields(Tabletop)}
    values = dict[str, Any]()
    for setting in settings:
        name, _, text = setting.partition("=")
        if name not in names:
            raise KitError(f"--set {setting}: there is no dimension {name!r}; see src/palmd/config/tabletop.py")
        try:
            values[name] = type(getattr(TABLETOP, name))(float(text))
        except ValueError:
            raise KitError(f"--set {setting}: {text!r} is not a number; write {name}=MM") from None
    return replace(TABLETOP, **values)


def make(folder: Path, geometry: Tabletop) -> list[str]:
    """Write all files; return one line per file with its outcome. Raises KitError and FirmwareError."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in TEXTS.items():
        (folder / name).write_text(text(geometry), encoding="utf-8")
    lines = [f"{name}: written" for name in TEXTS]
    lines += printed(folder, geometry)
    lines += [f"{name}: {outcome}" for name, outcome in firmware.build(folder).items()]
    return lines


def printed(folder: Path, geometry: Tabletop) -> list[str]:
    """Write and check the printed parts as STL and 3MF."""
    if shutil.which("openscad") is None:
        return ["STL and 3MF: skipped: no openscad (apt-get install openscad); parts are not checked"]
    shutil.copy(PROGRAM, folder)
    parts, lines = {}, []
    for name in PARTS:
        for target in (folder / f"{name}.stl", folder / f"{name}.3mf"):
            _openscad(folder / PROGRAM.name, f'part="{name}"', target)
        parts[name] = read_stl(folder / f"{name}.stl")
        _check(name, parts[name], geometry)
        size = " × ".join(f"{length:.1f}" for length in parts[name].size)
        lines.append(f"{name}.stl, {name}.3mf: {size} mm, {parts[name].volume / 1e3:.1f} cm³, watertight")
    if found := list(collisions(geometry, parts)):
        raise KitError("\n".join(found))
    return [*lines, "assembly: no parts overlap"]


def _check(name: str, mesh: Mesh, geometry: Tabletop) -> None:
    if edges := open_edges(mesh):
        raise KitError(f"{name}.stl is not watertight: {edges} edges are not shared by two triangles")
    if mesh.volume <= 0.0:
        raise KitError(f"{name}.stl is inside out")
    if not fits(mesh, geometry.bed):
        raise KitError(f"{name}.stl does not fit a bed of {geometry.bed:g} mm")


def _openscad(program: Path, setting: str, target: Path) -> None:
    done = subprocess.run(
        ["openscad", "-q", "-D", setting, "-o", str(target), str(program)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise KitError(f"openscad: {done.stderr.strip()}")


def main(arguments: list[str]) -> int:
    """Run `make kit`; return 1 for a geometry that cannot be built."""
    parser = argparse.ArgumentParser(prog="make kit", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER", help="default: %(default)s")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=MM", help="change a dimension")
    chosen = parser.parse_args(arguments)
    try:
        lines = make(chosen.output, changed(chosen.set))
    except (KitError, firmware.FirmwareError) as error:
        print(error, file=sys.stderr)
        return 1
    print("\n".join(lines), f"in {chosen.output}", sep="\n")
    return 0
