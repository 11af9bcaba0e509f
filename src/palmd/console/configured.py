"""Which configuration a command means that was given none, and how it ends when it is of no use."""

from __future__ import annotations

from pathlib import Path

from palmd.config.any_config import AnyConfig
from palmd.config.two_palms import Config
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.shipped import shipped
from palmd.yamlfile import ConfigError, load_any_config, load_config

INSTALLED = Path("/etc/palmd/palmd.yaml")


def usual(path: Path | None) -> Path:
    """The path given, else that of the installed configuration, else of the shipped one."""
    return path or (INSTALLED if _stands(INSTALLED) else shipped("palmd.yaml"))


def _stands(path: Path) -> bool:
    """Whether it is there; what may not be looked at is, and whoever reads it tells."""
    try:
        return path.exists()
    except PermissionError:
        return True


def configured(path: Path) -> Config:
    """The configuration in a file; CliError with every error in it."""
    try:
        return load_config(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None


def any_configured(path: Path) -> AnyConfig:
    """The configuration in a file, of whatever system; CliError with every error in it."""
    try:
        return load_any_config(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None


def with_flat_palms(path: Path, what: str) -> Config:
    """`configured`; CliError where palms are curved, which `what` is not made for."""
    config = configured(path)
    if any(config.rig.curvatures_per_m):
        raise CliError(BAD_INPUT, f"{path}: {what} is evaluated on flat palms only, and these are curved")
    return config
