"""The exception of the library."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from palmd.console.errors import CliError
from palmd.keys import KeysError
from palmd.outlinefile import OutlineError
from palmd.record import RunError
from palmd.record.eventlog import LogError
from palmd.record.systems import NotYetError


class PalmdError(Exception):
    """A request that cannot be fulfilled; the text is one line that says where, why, and what to do."""


@contextmanager
def as_palmd_error() -> Iterator[None]:
    """Convert palmd's internal exceptions for invalid input or an unreachable rig to PalmdError."""
    try:
        yield
    except (CliError, KeysError, LogError, NotYetError, OutlineError, RunError) as error:
        raise PalmdError(str(error)) from None
