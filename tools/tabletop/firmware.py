"""Builds the strip's firmware with Debian's compilers: for boards with an ATmega32U4, and its core for a Cortex-M0+."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

FIRMWARE = Path(__file__).parents[1] / "strip"
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
AVR_PACKAGES = "gcc-avr avr-libc arduino-core-avr"
ARM_PACKAGES = "gcc-arm-none-eabi libnewlib-arm-none-eabi"
MCU = "atmega32u4"
FLASH_BYTES = 28672
"""The ATmega32U4's flash without the bootloader."""

_AVR = (
    f"-mmcu={MCU} -DF_CPU=16000000L -DARDUINO=10808 -DARDUINO_AVR_MICRO -DARDUINO_ARCH_AVR -DUSB_VID=0x2341"
    ' -DUSB_PID=0x8037 -DUSB_MANUFACTURER="palmd" -DUSB_PRODUCT="strip" -DDECIMAL_DIG=17'
    " -Os -w -ffunction-sections -fdata-sections"
).split()
_STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-Os", "-c")


class FirmwareError(Exception):
    """The firmware does not compile or does not fit."""


def build(folder: Path) -> dict[str, str]:
    """Build into the folder; return the outcome by file: built, or why it was skipped. Raises FirmwareError."""
    return {"strip-atmega32u4.hex": _hex(folder), "strip-cortex-m0plus.o": _core(folder)}


def _hex(folder: Path) -> str:
    """Build the complete firmware for an Arduino Micro or Leonardo, as a HEX file for avrdude."""
    if shutil.which("avr-g++") is None or not ARDUINO.is_dir():
        return f"skipped: no AVR compiler or Arduino core (apt-get install {AVR_PACKAGES})"
    core, work = ARDUINO / "cores/arduino", folder / "objects"
    work.mkdir(exist_ok=True)
    wire = ARDUINO / "libraries/Wire/src"
    include = [f"-I{path}" for path in (core, ARDUINO / "variants/micro", FIRMWARE, wire, wire / "utility")]
    sketch = work / "strip.ino.cpp"
    sketch.write_text("#include <Arduino.h>\n" + (FIRMWARE / "strip.ino").read_text(encoding="utf-8"), encoding="utf-8")
    sources = [
        sketch,
        FIRMWARE / "strip.c",
        wire / "Wire.cpp",
        wire / "utility/twi.c",
        *sorted(each for each in core.iterdir() if each.suffix in (".c", ".cpp")),
    ]
    objects = []
    for source in sources:
        cpp = source.suffix == ".cpp"
        options = ["-std=gnu++11", "-fno-exceptions", "-fno-threadsafe-statics"] if cpp else ["-std=gnu11"]
        objects.append(str(work / f"{source.name}.o"))
        _run("avr-g++" if cpp else "avr-gcc", *_AVR, *options, *include, "-c", str(source), "-o", objects[-1])
    program = str(work / "strip.elf")
    _run("avr-gcc", f"-mmcu={MCU}", "-Os", "-Wl,--gc-sections", *objects, "-lm", "-o", program)
    target = folder / "strip-atmega32u4.hex"
    _run("avr-objcopy", "-O", "ihex", "-R", ".eeprom", program, str(target))
    used = flash_bytes(target)
    if used > FLASH_BYTES:
        raise FirmwareError(f"{target.name} needs {used} bytes of flash, the board has {FLASH_BYTES}")
    shutil.rmtree(work)
    return f"built: {used} of {FLASH_BYTES} bytes of flash"


def _core(folder: Path) -> str:
    """Compile the board-independent part with strict warnings for the processor of an RP2040 or SAMD21."""
    if shutil.which("arm-none-eabi-gcc") is None:
        return f"skipped: no ARM compiler (apt-get install {ARM_PACKAGES})"
    target = folder / "strip-cortex-m0plus.o"
    _run("arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb", *_STRICT, str(FIRMWARE / "strip.c"), "-o", str(target))
    return "built: only the core; build strip.ino with the board's tools"


def flash_bytes(path: Path) -> int:
    """Return the number of data bytes in an Intel HEX file; raises ValueError for a wrong checksum."""
    total = 0
    for line in path.read_text(encoding="ascii").splitlines():
        record = bytes.fromhex(line.removeprefix(":"))
        if sum(record) % 256:
            raise ValueError(f"{path.name}: a record with a wrong checksum: {line}")
        total += record[0] if record[3] == 0 else 0
    return total


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FirmwareError(f"{' '.join(command)}\n{done.stderr.strip()}")
