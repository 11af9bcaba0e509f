"""A wheel with kernels in an environment without compiler or cache: doctor and demo run compiled code.

The kernels are this machine's own; `make release` builds and tests portable ones.
"""

import json
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from palmd.cli.build import needed_by
from palmd.console.errors import RIG_FAILED
from palmd.console.shipped import shipped
from palmd.model.compiled import cache_directory
from palmd.rig import vibrating_plant
from palmd.yamlfile import load_any_config
from tools.release import run_without_compiler
from tools.wheel import build_wheel, collect

pytestmark = pytest.mark.rig

DEMO_S = 4.0


def kernels_of_the_demo(folder):
    """Copies them from the cache into `folder`, without those of other versions."""
    for _, make in needed_by(load_any_config(shipped("demo.yaml"))):
        make()
    assert vibrating_plant.backend() == "c"
    loaded = {Path(line.split()[-1]).name for line in Path("/proc/self/maps").read_text().splitlines() if "/" in line}
    notes = [note for note in cache_directory().glob("*-*.json") if json.loads(note.read_bytes())["library"] in loaded]
    collect(notes, (), folder)
    return folder


def installed(wheel, folder):
    """The command of a new environment that has its own wheel and uses the dependencies of this one."""
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin/python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check", "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-index", str(wheel)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "needed.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin/palmd"


def test_doctor_and_demo(tmp_path):
    wheel = build_wheel(tmp_path, kernels_of_the_demo(tmp_path / "kernels"))
    assert "-any." not in wheel.name
    command = installed(wheel, tmp_path / "venv")
    demo = run_without_compiler(command, tmp_path, DEMO_S)
    assert demo.stdout.startswith("palmd demo: seed 3")
    assert demo.returncode in (0, RIG_FAILED), "four seconds may be too few to converge"
    assert not list(tmp_path.rglob(".cache/**/*.so")), "nothing was compiled"
