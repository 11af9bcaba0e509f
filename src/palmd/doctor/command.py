"""What is missing, in order, with the command that mends it; or one part of the rig put to the test.

Without an option it changes nothing and moves nothing. Exit status 0 only if all is well.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from palmd.config.arms import AdeptConfig, ServosConfig
from palmd.config.fields import BAUDS, SERVO_BAUDS
from palmd.console.configured import INSTALLED, configured, usual
from palmd.console.errors import BAD_INPUT, CliError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("config", nargs="?", type=Path, metavar="CONFIG",
                        help=f"the rig's configuration (default: {INSTALLED}, else as shipped)")  # fmt: skip
    test = parser.add_mutually_exclusive_group()
    test.add_argument("--arm-conformance", action="store_true",
                      help="check by check, whether the arm's controller keeps the contract of the link")  # fmt: skip
    test.add_argument("--actuator-conformance", action="store_true",
                      help="the same of whatever turns the palms, an arm or servos")  # fmt: skip
    test.add_argument("--touch", action="store_true", help="which pad is which, and which way round: by touching them")
    parser.add_argument("--port", metavar="PATH", help="of the arm, instead of the configured one")
    parser.add_argument(
        "--baud", type=int, choices=sorted({*BAUDS, *SERVO_BAUDS}), help="of the arm, instead of the configured one"
    )
    parser.add_argument("--yes", action="store_true", help="the arm may move: do not ask")


def run(arguments: argparse.Namespace) -> int:
    """Returns the exit status; CliError for a configuration that cannot be used, and for a rig that does not answer."""
    path = usual(arguments.config)
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
    """The arm's port and baud: what was given, and the configuration's for the rest."""
    if arguments.port and not arguments.config:
        return arguments.port, arguments.baud or AdeptConfig(port=arguments.port).baud
    arm = configured(path).arm
    if isinstance(arm, ServosConfig):
        raise CliError(BAD_INPUT, f"{path}: arm.kind {arm.kind} is on no arm link: palmd doctor --actuator-conformance")
    return arguments.port or arm.port, arguments.baud or arm.baud
