"""Checks machine, configuration and rig, and prints what is missing with the command that fixes it; or tests one part.

Without an option it changes nothing and moves nothing. Exit status 0 only if everything is in order.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.config.arms import AdeptConfig, ServosConfig
from palmd.config.fields import BAUDS, SERVO_BAUDS
from palmd.console.configured import INSTALLED, configured, default_path
from palmd.console.errors import BAD_INPUT, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help=f"the rig's configuration (default: {INSTALLED}, else the shipped one)")  # fmt: skip
    test = parser.add_mutually_exclusive_group()
    test.add_argument("--arm-conformance", action="store_true",
                      help="check whether the arm's controller conforms to the arm link's protocol")  # fmt: skip
    test.add_argument("--actuator-conformance", action="store_true",
                      help="the same for the configured actuator, an arm or servos")  # fmt: skip
    test.add_argument(
        "--touch", action="store_true", help="find which pad is which and its orientation, by touching them"
    )
    parser.add_argument("--port", metavar="PATH", help="the arm's port, instead of the configured one")
    parser.add_argument(
        "--baud",
        type=int,
        choices=sorted({*BAUDS, *SERVO_BAUDS}),
        help="the arm's baud rate, instead of the configured one",
    )
    parser.add_argument("--yes", action="store_true", help="allow the arm to move without asking")


def run(arguments: argparse.Namespace) -> int:
    """Return the exit status. CliError for an invalid configuration, and if the rig does not answer."""
    path = default_path(arguments.config)
    if arguments.actuator_conformance and (arguments.config or not arguments.port):
        arm = configured(path).arm
        if isinstance(arm, ServosConfig):
            from palmd.doctor.servos import examine_servos

            given = {"port": arguments.port, "baud": arguments.baud}
            arm = arm.model_copy(update={key: value for key, value in given.items() if value})
            return examine_servos(arm, arguments.yes)
    if arguments.arm_conformance or arguments.actuator_conformance:
        from palmd.doctor.arm import examine_arm

        port, baud = _arm(arguments, path)
        return examine_arm(port, baud, arguments.yes)
    if arguments.touch:
        from palmd.doctor.touch import examine_pads

        return examine_pads(path, configured(path).pads)
    if arguments.port or arguments.baud or arguments.yes:
        raise CliError(BAD_INPUT, "--port, --baud and --yes belong to --arm-conformance and --actuator-conformance")
    from palmd.doctor.findings import examine_all

    return examine_all(path)


def _arm(arguments: argparse.Namespace, path: Path) -> tuple[str, int]:
    """Return the arm's port and baud: from the arguments, else from the configuration."""
    if arguments.port and not arguments.config:
        return arguments.port, arguments.baud or AdeptConfig(port=arguments.port).baud
    arm = configured(path).arm
    if isinstance(arm, ServosConfig):
        raise CliError(
            BAD_INPUT, f"{path}: arm.kind {arm.kind} does not use the arm link: use palmd doctor --actuator-conformance"
        )
    return arguments.port or arm.port, arguments.baud or arm.baud
