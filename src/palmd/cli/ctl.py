"""Sends a command to a running daemon and prints its answer."""

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
from palmd.console.arguments import between
from palmd.console.errors import BAD_INPUT, RIG_FAILED, USAGE, CliError, as_cli_error
from palmd.daemon.commands import COMMANDS, REQUEST_BYTES_MAX
from palmd.harness.processes import StopRequest
from palmd.system.mechanism import JOINTS
from palmd.systems import LIVE, load_part

PLAN_BYTES_MAX = REQUEST_BYTES_MAX // 2

KEPT_S = 3.0
"""Lease (s) of `--keep`, which is renewed six times as often."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command of the daemon."""
    common = argparse.ArgumentParser(add_help=False)
    for each in (parser, common):  # both before and after the command
        each.add_argument("--address", help=f"the daemon's command socket (default: as configured, {COMMAND})")
        add_config(each)
        add_key(each)
        each.add_argument("--json", action="store_true", help="print the answer as JSON")
    for action in common._actions:
        action.default = argparse.SUPPRESS  # options after the command override those before it
    kept = f"keep control until Ctrl-C; moving palms are held {KEPT_S:g} s after this command has ended"
    file = "the plan (YAML), or the name of one in the folder of the daemon's configured plan"
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, spec in COMMANDS.items():
        if not spec.by_hand:
            continue
        chosen = commands.add_parser(name, parents=[common], help=spec.does, description=spec.does)
        if spec.moves:
            chosen.add_argument("--take", action="store_true", help="take control from another client")
            chosen.add_argument("--keep", action="store_true", help=kept)
        if name == "plan":
            chosen.add_argument("path", type=Path, metavar="FILE", help=file)
        elif name == "note":
            chosen.add_argument(
                "text", nargs="+", metavar="TEXT", help="text of the note, stored with the current time of the run"
            )
        elif name == "jog":
            for joint in JOINTS:
                chosen.add_argument(f"--{joint}-deg", type=between(-90, 90), default=0.0, metavar="DEG",
                                    help=f"angle by which to turn {joint}")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Send the command once, for a jog until the palms have turned; CliError if it is refused or unanswered."""
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
            _keep_control(client)
    if reply["ok"]:
        return 0
    if arguments.json:
        return BAD_INPUT
    raise CliError(BAD_INPUT, str(reply.get("error")))


def _print(arguments: argparse.Namespace, reply: dict[str, Any]) -> None:
    if arguments.json:
        print(json.dumps(reply))
    elif reply["ok"]:
        print(as_text(arguments.command, reply.get("result") or {}), flush=True)


def _keep_control(client: CommandClient) -> None:
    """Renew the lease until SIGINT or SIGTERM; CliError if another client has taken control."""
    print(f"{client.client} keeps control until Ctrl-C; then moving palms are held within {KEPT_S:g} s", flush=True)
    with StopRequest() as stop:
        while not stop.made:
            reply = client.ask("alive")
            owner = (reply.get("result") or {}).get("control", "")
            if owner != client.client:
                raise CliError(RIG_FAILED, f"control was taken by {owner or 'nobody'}")
            time.sleep(KEPT_S / 6)


def _plan(path: Path) -> dict[str, Any]:
    """Send the plan's text, since the daemon opens no files of clients; a missing file is a name of its own plans."""
    from palmd.yamlfile import ConfigError, read_text

    if not os.path.lexists(path):
        return {"path": str(path)}
    with as_cli_error(ConfigError):
        text = read_text(path)
    if not text:
        raise CliError(BAD_INPUT, f"{path}:1:1: the file is empty")
    if len(text.encode()) > PLAN_BYTES_MAX:
        raise CliError(BAD_INPUT, f"{path}: larger than {PLAN_BYTES_MAX // 1000} kB, the maximum that can be sent")
    return {"path": str(path), "text": text}


def as_text(command: str, result: dict[str, Any]) -> str:
    """A result as text."""
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
        lines.append(f"        explored {_exploration_text(**result['explored'])}")
    if "recorder" in result:
        lines.append(f"record  {_recorder_text(result['recorder'])}")
    lines.append(f"arm     {arm}")
    if result["arm_error"]:
        lines.append(f"        {result['arm_error']}")
    faults = zip(result["faults"], result["severities"], result["hints"], strict=True)
    lines += [f"fault   {code} ({severity}): {hint}" for code, severity, hint in faults]
    lines += [f"{'' if number else 'log':8}{line}" for number, line in enumerate(_log_lines(result))]
    return "\n".join(lines)


def _system(estimate: Mapping[str, Any]) -> str:
    """System of an estimate, by its fields; two palms if there is no estimate yet."""
    from palmd.topics import SYSTEM_TOPICS

    fields = {name: topics.estimate.quantities for name, topics in SYSTEM_TOPICS.items()}
    return max(fields, key=lambda name: sum(each.name in estimate for each in fields[name]))


def _log_lines(result: dict[str, Any]) -> list[str]:
    """The last log entries of a status reply."""
    if "log" not in result:
        return []
    from palmd.cli.board import ago
    from palmd.messages import entries_of

    return [f"{ago(result['t_s'] - entry.t_s)}  {entry.line}" for entry in entries_of(result["log"])]


def _exploration_text(coverage: float | None, reachable: float | None, reason: str) -> str:
    """Coverage and reason of an exploration as text."""
    of = "" if reachable is None else f" of the {reachable:.0%} of the outline that can be reached"
    how_much = "nothing yet" if coverage is None else f"{coverage:.0%}{of}"
    return f"{how_much}: {reason}" if reason else how_much


def _recorder_text(status: Mapping[str, Any]) -> str:
    """The recorder's last status as text; unknown fields are ignored."""
    text = f"{status.get('path', 'no file')}, {status['messages']:.0f} messages, {status['bytes'] / 1e6:.1f} MB"
    text += f", {status['lost']:.0f} lost" if status["lost"] else ""
    problem = status.get("problem")
    return f"{text}: {problem}" if problem else f"{text}, {status['age_s']:.0f} s ago"
