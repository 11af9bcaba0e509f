"""What every recording begins with: the configuration, the versions, and what an observer was told beforehand."""

from __future__ import annotations

import json
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import yaml

from palmd import __version__
from palmd.config import config_hash, rig_description
from palmd.outlinefile import SUFFIXES
from palmd.pivot_config import AnyConfig, PivotConfig, pivot_rig
from palmd.quantities import SCHEMA
from palmd.record.mcapfile import Preface

METADATA = "palmd"
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
    rig = pivot_rig(config) if isinstance(config, PivotConfig) else rig_description(config)
    stored = None if isinstance(config, PivotConfig) else config.observer.shape
    attachments = {
        CONFIG: yaml.safe_dump(config.model_dump(mode="json"), allow_unicode=True).encode(),
        RIG: json.dumps(asdict(rig)).encode(),
    }
    return Preface({METADATA: metadata}, attachments | _outlines(stored))


def _outlines(path: Path | None) -> dict[str, bytes]:
    if path is None:
        return {}
    files = [each for each in path.iterdir() if each.suffix.lower() in SUFFIXES] if path.is_dir() else [path]
    return {OUTLINES + each.name: each.read_bytes() for each in sorted(files)}
