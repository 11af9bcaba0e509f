"""`python -m tools.conformance arm PORT` or `servos PORT`, in a checkout."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import cast

from palmd.cli import status_of
from palmd.config.arms import AdeptConfig, DynamixelConfig
from palmd.config.fields import BAUDS, SERVO_BAUDS
from palmd.console.arguments import Parser
from palmd.console.configured import configured
from palmd.console.errors import BAD_INPUT, CliError
from tools.conformance.arm import examine_arm
from tools.conformance.servos import examine_servos


def main(argv: Sequence[str] | None = None) -> int:
    """Return 0 if all checks passed, 1 for wrong input or without permission to move, 3 if a check failed."""
    return status_of(lambda: (cast(ModuleType, SimpleNamespace(run=_run)), _parser().parse_args(argv)))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m tools.conformance", description="Checks whether an actuator conforms to palmd's"
                    " protocol. Checks that move ask first. The daemon must not run.")  # fmt: skip
    parser.add_argument("what", choices=("arm", "servos"), help="a controller with the arm link's protocol, or servos")
    parser.add_argument("port", metavar="PORT")
    parser.add_argument("--config", type=Path, metavar="FILE",
                        help="take baud rate, and the servos' kind and settings, from this rig's configuration"
                        " (default: an arm at 38400 bit/s, two Dynamixel servos)")  # fmt: skip
    parser.add_argument(
        "--baud", type=int, choices=sorted({*BAUDS, *SERVO_BAUDS}), help="instead of the configured one"
    )
    parser.add_argument("--yes", action="store_true", help="allow the actuator to move without asking")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    path, port, is_arm = arguments.config, arguments.port, arguments.what == "arm"
    default = AdeptConfig(port=port) if is_arm else DynamixelConfig(kind="dynamixel", port=port)
    arm = configured(path).arm if path else default
    if isinstance(arm, AdeptConfig) is not is_arm:
        raise CliError(BAD_INPUT, f"{path}: arm.kind is {arm.kind}, which this suite does not check")
    arm = arm.model_copy(update={"port": port, "baud": arguments.baud or arm.baud})
    if isinstance(arm, AdeptConfig):
        return examine_arm(arm.port, arm.baud, arguments.yes)
    return examine_servos(arm, arguments.yes)


if __name__ == "__main__":
    sys.exit(main())
