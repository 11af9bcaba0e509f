"""Preface of a recording: versions, configuration, rig description and stored outlines."""

from __future__ import annotations

import contextlib
import json
import platform
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import yaml

from palmd import __version__
from palmd.config.any_config import AnyConfig, as_yaml, config_hash
from palmd.outlinefile import SUFFIXES
from palmd.quantities import SCHEMA
from palmd.record import METADATA
from palmd.record.mcapfile import Preface
from palmd.record.mcapread import Layout
from palmd.systems import LIVE, load_part
from palmd.yamlfile import ConfigError, recorded_config

CONFIG, RIG, OUTLINES = "config.yaml", "rig.json", "outlines/"


def preface(config: AnyConfig, started: str, continues: str = "", gap_s: float = 0.0) -> Preface:
    """The preface of a run that began at `started` (ISO 8601) and continues the recording `continues` (empty: none).

    `gap_s` is the unrecorded time between the two. Stored outlines are read from the configured path; raises OSError.
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
        "gap_s": f"{gap_s:.3f}",
    }
    rig = load_part(LIVE[config.system].description)(config)
    attachments = {
        CONFIG: as_yaml(config).encode(),
        RIG: json.dumps(asdict(rig)).encode(),
    }
    return Preface({METADATA: metadata}, attachments | _outlines(config.outlines))


def preface_of(layout: Layout) -> Preface:
    """The preface of a recorded file; missing parts are restored from the recorded `palm/config`, if there is one.

    A missing rig description is derived from the configuration.
    """
    preface, recorded = layout.preface, layout.config
    attachments, metadata = dict(preface.attachments), dict(preface.metadata)
    if recorded:
        attachments.setdefault(CONFIG, str(recorded.get("yaml")).encode())
        restored = {"schema": str(recorded.get("v")), "config_hash": str(recorded.get("config_hash"))}
        metadata.setdefault(METADATA, restored)
    if RIG not in attachments and CONFIG in attachments:
        with contextlib.suppress(ConfigError, yaml.YAMLError, UnicodeDecodeError):
            config = recorded_config(yaml.safe_load(attachments[CONFIG]))
            rig = load_part(LIVE[config.system].description)(config)
            attachments[RIG] = json.dumps(asdict(rig)).encode()
    return Preface(metadata, attachments)


def _outlines(path: Path | None) -> dict[str, bytes]:
    if path is None:
        return {}
    files = [each for each in path.iterdir() if each.suffix.lower() in SUFFIXES] if path.is_dir() else [path]
    return {OUTLINES + each.name: each.read_bytes() for each in sorted(files)}
