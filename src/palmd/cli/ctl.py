"""Tells a running daemon what to do, and prints what it answers."""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palmd.bus.addresses import add_config, command_address
from palmd.bus.command_client import CommandClient
from palmd.bus.jogging import jog
from palmd.bus.link import COMMAND, add_key, credentials
from palmd.console.errors import BAD_INPUT, RIG_FAILED, USAGE, CliError
from palmd.daemon.commands import COMMANDS, REQUEST_BYTES_MAX
from palmd.harness.processes import StopRequest
from palmd.system.mechanism import JOINTS
from palmd.systems import LIVE, load_part

PLAN_BYTES_MAX = REQUEST_BYTES_MAX // 2

KEPT_S = 3.0
"""The lease that `--keep` declares, and renews six times in it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments: those of every command that the daemon knows."""
    common = argparse.ArgumentParser(add_help=False)
    for each in (parser, common):  # before the command and behind it
        each.add_argument("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
        add_config(each)
        add_key(each)
        each.add_argument("--json", action="store_true", help="print the answer as it came")
    for action in common._actions:
        action.default = argparse.SUPPRESS  # what stands behind the command, if anything, replaces what stands before
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, spec in COMMANDS.items():
        if not spec.by_hand:
            continue
        chosen = commands.add_parser(name, parents=[common], help=spec.does, description=spec.does)
        if spec.moves:
            chosen.add_argument("--take", action="store_true", help="take control from the client that has it")
            chosen.add_argument(
                "--keep",
                action="store_true",
                help=f"keep control until Ctrl-C; {KEPT_S:g} s after the end of this command moving palms are held",
            )
        if name == "plan":
            chosen.add_argument(
                "path",
                type=Path,
                metavar="FILE",
                help="the plan (YAML), or the name of one that lies beside the daemon's configured plan",
            )
        elif name == "note":
            chosen.add_argument("text", nargs="+", metavar="TEXT", help="what to write about this time of the run")
        elif name == "jog":
            for joint in JOINTS:
                chosen.add_argument(
                    f"--{joint}-deg", type=_angle, default=0.0, metavar="DEG", help=f"by how much to turn {joint}"
                )


def run(arguments: argparse.Namespace) -> int:
    """Asks once, or for a jog until the palms have turned; CliError when refused or unanswered."""
    whole_deg = {f"{joint}_deg": getattr(arguments, f"{joint}_deg", 0.0) for joint in JOINTS}
    if arguments.command == "jog" and not any(whole_deg.values()):
        options = [f"--{joint}-deg" for joint in JOINTS]
        wanted = f"give {', '.join(options)} or both, such as {options[0]} 1"
        raise CliError(USAGE, f"ctl jog: by how much? {wanted}")
    address = command_address(arguments.address, arguments.config)
    keeps = getattr(arguments, "keep", False)
    take = {"take": True} if getattr(arguments, "take", False) else {}
    with CommandClient(address, key=credentials(arguments), lease_s=KEPT_S if keeps else None) as client:
        if arguments.command == "jog":
            reply = jog(client, whole_deg, take)
        elif arguments.command == "plan":
            reply = client.ask("plan", _plan(arguments.path) | take)
        elif arguments.command == "note":
            reply = client.ask("note", {"text": " ".join(arguments.text)})
        else:
            reply = client.ask(arguments.command, take)
        _print(arguments, reply)
        if keeps and reply["ok"]:
            _keep(client)
    if reply["ok"]:
        return 0
    if arguments.json:
        return BAD_INPUT
    raise CliError(BAD_INPUT, str(reply.get("error")))


def _print(arguments: argparse.Namespace, reply: dict[str, Any]) -> None:
    if arguments.json:
        print(json.dumps(reply))
    elif reply["ok"]:
        print(told(arguments.command, reply.get("result") or {}), flush=True)


def _keep(client: CommandClient) -> None:
    """Renew the lease until SIGINT or SIGTERM; CliError when another client has taken control."""
    print(f"{client.client} keeps control until Ctrl-C; then moving palms are held within {KEPT_S:g} s", flush=True)
    with StopRequest() as stop:
        while not stop.made:
            reply = client.ask("alive")
            owner = (reply.get("result") or {}).get("control", "")
            if owner != client.client:
                raise CliError(RIG_FAILED, f"control has gone to {owner or 'nobody'}")
            time.sleep(KEPT_S / 6)


def _plan(path: Path) -> dict[str, Any]:
    """The plan goes along, for the daemon opens no file of ours; what is not here is a name among its own plans."""
    from palmd.yamlfile import ConfigError, read_text

    if not os.path.lexists(path):
        return {"path": str(path)}
    try:
        text = read_text(path)
    except ConfigError as error:
        raise CliError(BAD_INPUT, str(error)) from None
    if not text:
        raise CliError(BAD_INPUT, f"{path}:1:1: the file is empty")
    if len(text.encode()) > PLAN_BYTES_MAX:
        raise CliError(BAD_INPUT, f"{path}: larger than {PLAN_BYTES_MAX // 1000} kB, the most that can be sent along")
    return {"path": str(path), "text": text}


def told(command: str, result: dict[str, Any]) -> str:
    """A result in words."""
    if command == "reset" and "cleared" in result:
        cleared = ", ".join(result["cleared"])
        return f"state {result['state']}, " + (f"cleared: {cleared}" if cleared else "there was nothing to reset")
    if command == "note":
        return "noted"
    if command != "status":
        return ", ".join(f"{name} {value}" for name, value in result.items())
    plan = result["plan"] or "none"
    if result["segment"] >= 0:
        plan += f", segment {result['segment']} ({result['doing']}), {result['progress']:.0%}"
    arm = (f"state {result['arm_state']}" if result["arm_state"] else "state unknown") + (
        "" if result["arm_linked"] else ", does not answer"
    )
    since = f": {result['cause']}" if result["cause"] else ""
    unattended = ", the motion is unattended" if result.get("unattended") else ""
    owner = result.get("control", "")
    control = [f"control {owner or 'nobody'}{unattended}"] if owner or unattended else []
    lines = [f"state   {result['state']}{since}", *control, f"plan    {plan}"]
    lines += load_part(LIVE[_system(result.get("estimate", {}))].status)(result)
    if "explored" in result:
        lines.append(f"        explored {_explored(**result['explored'])}")
    if "recorder" in result:
        lines.append(f"record  {_recorded(result['recorder'])}")
    lines.append(f"arm     {arm}")
    if result["arm_error"]:
        lines.append(f"        {result['arm_error']}")
    faults = zip(result["faults"], result["severities"], result["hints"], strict=True)
    lines += [f"fault   {code} ({severity}): {hint}" for code, severity, hint in faults]
    lines += [f"{'' if number else 'log':8}{line}" for number, line in enumerate(_logged(result))]
    return "\n".join(lines)


def _system(estimate: Mapping[str, Any]) -> str:
    """Whose estimate it is, by what it tells of; that of two palms, where there is none yet."""
    from palmd.topics import SYSTEM_TOPICS

    def alike(name: str) -> int:
        return sum(each.name in estimate for each in SYSTEM_TOPICS[name].estimate.quantities)

    return max(SYSTEM_TOPICS, key=alike)


def _logged(result: dict[str, Any]) -> list[str]:
    """The last entries of the log that came with a status."""
    if "log" not in result:
        return []
    from palmd.cli.board import ago
    from palmd.messages import entries_of

    return [f"{ago(result['t_s'] - entry.t_s)}  {entry.line}" for entry in entries_of(result["log"])]


def _explored(coverage: float | None, reachable: float | None, reason: str) -> str:
    """How much an exploration has touched, and what it says for itself."""
    of = "" if reachable is None else f" of the {reachable:.0%} of the outline that can be reached"
    how_much = "nothing yet" if coverage is None else f"{coverage:.0%}{of}"
    return f"{how_much}: {reason}" if reason else how_much


def _recorded(said: Mapping[str, Any]) -> str:
    """What the recorder said last; fields that are not known here are passed over."""
    text = f"{said.get('path', 'no file')}, {said['messages']:.0f} messages, {said['bytes'] / 1e6:.1f} MB"
    text += f", {said['lost']:.0f} lost" if said["lost"] else ""
    problem = said.get("problem")
    return f"{text}: {problem}" if problem else f"{text}, {said['age_s']:.0f} s ago"


def _angle(text: str) -> float:
    angle = float(text)
    if not abs(angle) <= 90.0:
        raise argparse.ArgumentTypeError(f"must be -90 to 90, got {text}")
    return angle
