"""Where a study's runs are done, as its command line says: processes of this machine, or a Dask cluster."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack

from palmd.console.arguments import count
from palmd.console.errors import BAD_INPUT, CliError
from palmd.console.extras import missing, only_without
from tools.studies import runs
from tools.studies.rows import on_this_machine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """How many processes, or which cluster."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=count, metavar="J", help="processes on this machine (default: one a processor)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster, such as tcp://127.0.0.1:8786")


def asked_for(arguments: argparse.Namespace) -> Callable[[ExitStack], Executor]:
    """Workers for `rows.collected`; they raise CliError where there is no such cluster, or no Dask."""
    address = arguments.scheduler
    return on_this_machine(arguments.jobs) if address is None else lambda stack: _of_cluster(stack, address)


def _of_cluster(stack: ExitStack, address: str) -> Executor:
    try:
        return stack.enter_context(runs.cluster(address))
    except ModuleNotFoundError as error:
        only_without("distributed", error)
        raise missing("--scheduler", "Dask", "studies") from None
    except (OSError, ValueError) as error:
        raise CliError(BAD_INPUT, f"no Dask scheduler at {address}: {error}") from None
