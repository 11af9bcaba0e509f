"""Loads the configuration of a command, with defaults and errors."""

from __future__ import annotations

from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.config.two_palms import Config
from palmd.console.errors import BAD_INPUT, CliError, as_cli_error
from palmd.console.shipped import shipped
from palmd.yamlfile import ConfigError, load_any_config, load_config

INSTALLED = Path("/etc/palmd/palmd.yaml")


def default_path(path: Path | None) -> Path:
    """Return `path`, else the path of the installed configuration, else of the shipped one."""
    return path or (INSTALLED if _exists(INSTALLED) else shipped("palmd.yaml"))


def _exists(path: Path) -> bool:
    """Whether `path` exists; True without permission to check, since reading it then reports the error."""
    try:
        return path.exists()
    except PermissionError:
        return True


def configured(path: Path) -> Config:
    """Load a configuration of two palms; CliError with all its errors."""
    with as_cli_error(ConfigError):
        return load_config(path)


def any_configured(path: Path) -> AnyConfig:
    """Load a configuration of any system; CliError with all its errors."""
    with as_cli_error(ConfigError):
        return load_any_config(path)


def with_flat_palms(path: Path, what: str) -> Config:
    """As `configured`; CliError for curved palms, which `what` does not support."""
    config = configured(path)
    if any(config.rig.curvatures_per_m):
        raise CliError(BAD_INPUT, f"{path}: {what} supports flat palms only, and these are curved")
    return config
