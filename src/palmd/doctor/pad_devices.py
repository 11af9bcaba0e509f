"""Checks of the pads' devices before they are opened: which device it is, and whether its units are right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.config.pads import AnyPads, PadConfig
from palmd.devices.pad import inspect_pad
from palmd.doctor.finding import Finding
from palmd.yamlfile import Document


def device_findings(name: str, pad: PadConfig, path: Path) -> Iterator[Finding]:
    """Yield each remark of a pad's driver as a finding."""
    for remark in inspect_pad(pad).remarks:
        fix = remark.fix or ("" if remark.verdict == "ok" else f"edit {path}")
        yield Finding(f"{name} {remark.what}", remark.verdict, remark.text, fix)


def device_errors(document: Document, config: AnyConfig) -> list[str]:
    """Return contradictions between a configuration and its devices, as `file:line:col: text`.

    A device that is missing, or that this user may not open, is no error.
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
