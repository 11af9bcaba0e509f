"""A daemon's arm, commanded by another program as a person at `palmd ctl` would: loaded, armed, started, and left."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from palmd.cli.bus import Client
from palmd.cli.errors import BAD_INPUT, CliError

LOOK_S = 0.25
STANDING_S = 5.0  # for the palms to come to a stand when they are held


class Operation:
    """Remembers whether it has armed the arm, and then stops it in the end."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._armed = False

    def do(self, command: str, **args: Any) -> dict[str, Any]:
        """The result; CliError with the daemon's own words when it refuses."""
        reply = self._client.ask(command, args)
        if not reply["ok"]:
            raise CliError(BAD_INPUT, " ".join(str(reply.get("error")).split()))
        result: dict[str, Any] = reply.get("result") or {}
        return result

    def load(self, plan: Mapping[str, Any]) -> None:
        """Hand a plan over; CliError when the daemon finds fault with it."""
        with tempfile.TemporaryDirectory(prefix="palmd-plan-") as name:
            folder = Path(name)
            folder.chmod(0o755)  # the daemon may be another user's
            path = folder / f"{plan['name']}.yaml"
            path.write_text(yaml.safe_dump(dict(plan)), encoding="utf-8")
            self.do("plan", path=str(path))

    def arm(self) -> None:
        """Arm, unless that has been done."""
        if self.do("status")["state"] == "ready":
            self.do("arm")
            self._armed = True

    def leave(self, *, over: bool) -> None:
        """Leave the palms standing, and the arm as it was found; unless all is `over`, the arm is stopped."""
        if not over and self._client.ask("hold")["ok"]:
            t_end = time.monotonic() + STANDING_S
            while time.monotonic() < t_end and self.do("status")["moving"]:
                time.sleep(LOOK_S)
        if self._armed or not over:
            self._client.ask("stop")


def why(status: Mapping[str, Any]) -> str:
    """Which grave faults stand in the way, and what to do."""
    grave = [
        f"{code}: {hint}"
        for code, severity, hint in zip(status["faults"], status["severities"], status["hints"], strict=True)
        if severity in ("hold", "stop")
    ]
    return "; ".join(grave) or f"the state is {status['state']}: somebody else has stopped it"
