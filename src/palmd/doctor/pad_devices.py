"""What pads' own kinds say of them before they are opened: which device is there, and whether its units are right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.config.pads import AnyPads, PadConfig
from palmd.devices.pad import inspect_pad
from palmd.doctor.finding import Finding
from palmd.yamlfile import Document


def device_findings(name: str, pad: PadConfig, path: Path) -> Iterator[Finding]:
    """Each remark of a pad's kind as a finding."""
    for remark in inspect_pad(pad).remarks:
        fix = remark.fix or ("" if remark.verdict == "ok" else f"edit {path}")
        yield Finding(f"{name} {remark.what}", remark.verdict, remark.text, fix)


def device_errors(document: Document, config: AnyConfig) -> list[str]:
    """What a configuration says otherwise than the devices it names, `file:line:col: what`.

    A device that is not there, or that this user may not open, is no error.
    """
    pads = getattr(config, "pads", None)
    if not isinstance(pads, AnyPads):
        return []
    errors = []
    for palm in type(pads).model_fields:
        for remark in inspect_pad(getattr(pads, palm)).remarks:
            if remark.verdict != "ok":
                place = document.place(("pads", palm, remark.key))
                errors.append(document.line(place, f"pads.{palm}.{remark.key}: {remark.text}"))
    return errors
