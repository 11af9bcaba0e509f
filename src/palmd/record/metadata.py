"""What every recording begins with: the configuration, the versions, and what an observer was told beforehand."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import yaml

from palmd import __version__
from palmd.config.any_config import AnyConfig, config_hash
from palmd.outlinefile import SUFFIXES
from palmd.quantities import SCHEMA
from palmd.record import METADATA
from palmd.record.mcapfile import Preface
from palmd.systems import LIVE, load_part

CONFIG, RIG, OUTLINES = "config.yaml", "rig.json", "outlines/"


def preface(config: AnyConfig, started: str, continues: str = "") -> Preface:
    """For a run that began at `started` (ISO 8601) and goes on from the one named `continues`, empty for none.

    Stored outlines are read from where the configuration says; raises OSError.
    """
    metadata = {
        "schema": str(SCHEMA),
        "palmd": __version__,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "casadi": version("casadi"),
        "machine": platform.machine(),
        "config_hash": config_hash(config),
        "started": started,
        "continues": continues,
    }
    rig = load_part(LIVE[config.system].description)(config)
    attachments = {
        CONFIG: yaml.safe_dump(config.model_dump(mode="json"), allow_unicode=True).encode(),
        RIG: json.dumps(asdict(rig)).encode(),
    }
    return Preface({METADATA: metadata}, attachments | _outlines(config.outlines))


def _outlines(path: Path | None) -> dict[str, bytes]:
    if path is None:
        return {}
    files = [each for each in path.iterdir() if each.suffix.lower() in SUFFIXES] if path.is_dir() else [path]
    return {OUTLINES + each.name: each.read_bytes() for each in sorted(files)}
