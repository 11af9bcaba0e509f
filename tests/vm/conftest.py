"""One image, one rig, one installation; most tests share one machine that runs until the last of them.

PALMD_VM_KEEP=1 reuses the disk that the last run installed, for work on these tests.
"""

import os
from pathlib import Path

import pytest
import rigpc
from image import ImageError, build, folder, with_palmd


def pytest_collection_modifyitems(items):
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.vm)


@pytest.fixture(scope="session")
def image():
    try:
        return build()
    except ImageError as why_not:
        pytest.skip(f"no rig PC can be built: {why_not}")


@pytest.fixture(scope="session")
def rig(tmp_path_factory):
    rig = rigpc.Rig(tmp_path_factory.mktemp("rig"))
    yield rig
    rig.close()


@pytest.fixture(scope="session")
def installed(image):
    """A disk with palmd, configured for this rig."""
    if os.environ.get("PALMD_VM_KEEP") and (folder() / "installed.ext4").exists():
        return folder() / "installed.ext4"
    return with_palmd(image, rigpc.configure)


@pytest.fixture(scope="session")
def pc(image, rig, installed, tmp_path_factory):
    """The machine, booted with everything plugged in."""
    folder = tmp_path_factory.mktemp("pc")
    with rigpc.powered(image, rigpc.overlay(installed, folder / "disk.qcow2"), rig, folder) as pc:
        yield pc
