"""The one error of the library."""

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
    """What was asked for cannot be had; the text is one line that says where, why, and what to do."""


@contextmanager
def as_palmd_error() -> Iterator[None]:
    """Whatever palmd's rooms raise for bad input or a rig that is not there comes out as a PalmdError."""
    try:
        yield
    except (CliError, KeysError, LogError, NotYetError, OutlineError, RunError) as error:
        raise PalmdError(str(error)) from None
