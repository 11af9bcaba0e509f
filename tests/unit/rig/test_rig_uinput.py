"""An emulated pad as an input device of the kernel: ioctls checked against the kernel's header; and missing uinput."""

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from palmd.devices import evdev
from palmd.rig import uinput
from palmd.rig.uinput import UinputLine

HEADER = Path("/usr/include/linux/uinput.h")
ASKED = """
#include <linux/uinput.h>
#include <stdio.h>
int main(void) {
    printf("%u %u %u %u %u %u %u %u %zu %zu\\n", UI_DEV_CREATE, UI_DEV_DESTROY, (unsigned)UI_DEV_SETUP,
           (unsigned)UI_ABS_SETUP, (unsigned)UI_SET_EVBIT, (unsigned)UI_SET_KEYBIT, (unsigned)UI_SET_ABSBIT,
           (unsigned)UI_GET_SYSNAME(64), sizeof(struct uinput_setup), sizeof(struct uinput_abs_setup));
}
"""


@pytest.mark.skipif(not (HEADER.exists() and shutil.which("cc")), reason="the kernel's header and a compiler")
def test_numbers_and_sizes_are_those_of_the_kernels_header(tmp_path):
    (tmp_path / "asked.c").write_text(ASKED)
    subprocess.run(["cc", "-o", tmp_path / "asked", tmp_path / "asked.c"], check=True)
    output = subprocess.run([tmp_path / "asked"], check=True, capture_output=True, text=True).stdout
    ours = (
        uinput._CREATE, uinput._DESTROY, uinput._SETUP, uinput._ABS_SETUP, uinput._EVENT_BIT, uinput._KEY_BIT,
        uinput._AXIS_BIT, uinput._SYSNAME, uinput._SETUP_FORM.size, uinput._ABS_FORM.size,
    )  # fmt: skip
    assert tuple(map(int, output.split())) == ours


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """A stand-in for the kernel: a file that takes records, and the ioctls that it got."""
    asked = []

    def ioctl(_fd, number, argument=0):
        asked.append((number, bytes(argument) if isinstance(argument, (bytes, bytearray)) else argument))
        if number == uinput._SYSNAME:
            argument[:7] = b"input42"

    (tmp_path / "uinput").touch()
    (tmp_path / "sysfs/input42/event7").mkdir(parents=True)
    for name, path in (("UINPUT", "uinput"), ("SYSFS", "sysfs"), ("DEVICES", "dev")):
        monkeypatch.setattr(uinput, name, tmp_path / path)
    monkeypatch.setattr(uinput.fcntl, "ioctl", ioctl)
    return asked


def test_a_device_is_created_takes_records_and_is_removed(kernel, tmp_path):
    line = UinputLine(tmp_path / "pad1")
    assert uinput.available()
    line.plug()
    assert line.path.readlink() == tmp_path / "dev/event7"
    axes = [struct.unpack_from("<H", argument)[0] for number, argument in kernel if number == uinput._ABS_SETUP]
    assert axes == [evdev.ABS_X, evdev.ABS_Y, evdev.ABS_PRESSURE]
    created = [number for number, _ in kernel]
    assert created.index(uinput._SETUP) < created.index(uinput._CREATE) < created.index(uinput._SYSNAME)
    frame = evdev.encode([(evdev.EV_ABS, evdev.ABS_X, 12), (evdev.EV_SYN, evdev.SYN_REPORT, 0)], 1.0)
    assert line.write(frame) == frame == (tmp_path / "uinput").read_bytes()
    assert line.read(0) == (b"", False)
    line.unplug()
    assert (kernel[-1][0], line.plugged, line.path.is_symlink()) == (uinput._DESTROY, False, False)
    assert line.write(frame) == b""
    assert (line.bytes_sent, line.bytes_lost) == (len(frame), len(frame))


def test_a_kernel_that_refuses_leaves_nothing_open(kernel, tmp_path, monkeypatch):
    monkeypatch.setattr(uinput, "SYSFS", tmp_path / "nowhere")
    line = UinputLine(tmp_path / "pad1")
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(OSError, match="no event device for input42"):
        line.plug()
    assert not line.plugged
    assert len(list(Path("/proc/self/fd").iterdir())) == before
