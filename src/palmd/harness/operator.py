"""An automated operator: keeps the palms moving, or runs one plan on a running daemon and monitors it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import yaml

from palmd.bus.command_client import CommandClient
from palmd.console.errors import BAD_INPUT, RIG_FAILED, CliError
from palmd.harness.processes import StopRequest
from palmd.topics import SYSTEM_TOPICS

Status = Mapping[str, Any]

MOTIONS = frozenset(own.motion.name for own in SYSTEM_TOPICS.values())
AGAIN_S = 1.0
CALM_S = 0.5
LOOK_S = 0.25
LEASE_S = 5.0
"""The lease that the client of a `PlanRun` declares: its status requests renew it; when it ends the palms are held."""
PROGRESS_S = 1.0
COMING_TO_REST_S = 5.0  # for held palms to come to rest
HELD_S = 30.0  # longest hold, in which an operator may put the object back and start again


class Operator:
    """Arms, starts and resumes the motion according to the bus messages, as a human operator would. Pure.

    If another client holds or stops the palms, it sends no commands until they are started again; if another client
    loads another plan, it never sends commands again.
    """

    def __init__(self) -> None:
        self.state: Status = {}
        self.motion: Status = {}
        self._suspended = False
        self._plan, self._plan_replaced = "", False  # whether another client has loaded another plan
        self._t_commanded = -AGAIN_S
        self._wanted: str | None = None
        self._t_wanted = 0.0

    @property
    def moves(self) -> bool:
        """Whether the palms follow a plan."""
        return self.state.get("state") == "tracking" and self.motion.get("segment", -1) >= 0

    def take(self, topic: str, fields: Status) -> None:
        """Process every palm/state and palm/motion message."""
        if topic in MOTIONS:
            self.motion = fields
            plan = fields.get("plan", "")
            self._plan = self._plan or plan
            self._plan_replaced |= plan not in ("", self._plan)
        elif topic == "palm/state":
            self._suspended |= fields["requested_state"] not in ("", self.state.get("requested_state"))
            self.state = fields

    def resume(self) -> None:
        """The client that held or stopped the palms wants them to move again."""
        self._suspended = False

    def decide(self, t: float) -> str | None:
        """The command to send at t (s), None for none.

        After a hold or a fault it waits until the state has been unchanged for `CALM_S`.
        """
        if self.moves:
            self._suspended = False
        wanted = None
        if not (self._suspended or self._plan_replaced):
            wanted = _next(self.state.get("state"), self.state.get("severities", ()), moves=self.moves)
        if wanted != self._wanted:
            self._wanted, self._t_wanted = wanted, t
        delay = 0.0 if wanted == "arm" else CALM_S
        if wanted is None or t - self._t_wanted < delay or t - self._t_commanded < AGAIN_S:
            return None
        self._t_commanded = t
        return wanted


def still_needed(command: str, status: Status) -> bool:
    """Whether the daemon's current `status` calls for a command that was chosen from bus messages.

    On a busy machine these may be seconds old, and another client may have held or stopped the palms since.
    """
    moves = status["segment"] >= 0
    return not status["requested_state"] and _next(status["state"], status["severities"], moves=moves) == command


def _next(state: str | None, severities: Iterable[str], *, moves: bool) -> str | None:
    """The command that leads on from a state, None if there is none."""
    standing = set(severities)
    match state:
        case "ready" if "stop" not in standing:
            return "arm"
        case "tracking" if not moves:
            return "start"
        case "hold" if not standing & {"hold", "stop"}:
            return "start"
        case "fault":
            return "reset"
    return None


class PlanRun:
    """One plan on a running daemon: load, arm, start, monitor, leave at rest.

    Arms the arm if necessary, and then stops it at the end; a daemon that was tracking before continues to track.
    """

    def __init__(
        self,
        client: CommandClient,
        listen: Callable[[float], None],
        describe: Callable[[Status, float], str],
        *,
        resumes: Callable[[Status], bool] | None = None,
    ) -> None:
        """`listen(t_end)` processes published messages until t_end (s, monotonic clock).

        `describe(status, seconds)` describes the progress, for an error. `resumes(status)` decides whether to end a
        hold that no client requested and whose cause is gone; it must return True only if no hands are near the palms.
        Without it such holds are not ended.
        """
        self._resumes = resumes
        self.seconds = 0.0
        self._client, self._listen, self._describe = client, listen, describe
        self._armed = self._over = False

    def begin(self, plan: Mapping[str, Any]) -> None:
        """Load the plan, arm and start; CliError with the daemon's reason if it refuses."""
        can_move(self._client)
        load(self._client, plan)
        if self._do("status")["state"] == "ready":
            self._do("arm")
            self._armed = True
        try:
            self._do("start")
        except CliError:
            self.end()
            raise

    def run(self, plan: Mapping[str, Any], stop: StopRequest, progress: Callable[[Status, float], str]) -> Status:
        """`begin`, `watch` and `end`; returns the last status."""
        self.begin(plan)
        try:
            return self.watch(stop, progress)
        finally:
            self.end()

    def watch(self, stop: StopRequest, progress: Callable[[Status, float], str]) -> Status:
        """Monitor until the plan is complete or `stop` is made; returns the status.

        `progress(status, seconds)` is printed now and then. CliError if another client or a fault has ended the plan,
        or it stays held.
        """
        t_begin = time.monotonic()
        t_progress = t_tracking = t_begin
        while True:
            self._listen(time.monotonic() + LOOK_S)
            status, t = self._do("status"), time.monotonic()
            self.seconds = t - t_begin
            if status["state"] not in ("tracking", "hold"):
                raise CliError(RIG_FAILED, f"{self._describe(status, self.seconds)}; {why(status)}")
            if status["state"] == "tracking" and status["over"]:
                self._over = True
                return status
            if stop.made:
                return status
            if status["state"] == "tracking":
                t_tracking = t
            elif self._resumes and still_needed("start", status) and self._resumes(status):
                self._client.ask("start")
                t_tracking = time.monotonic()
            if t > t_tracking + HELD_S:
                raise CliError(RIG_FAILED, f"held for {HELD_S:g} s, so ended; {why(status)}")
            if t >= t_progress:
                t_progress = t + PROGRESS_S
                print(progress(status, self.seconds), file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the palms at rest and the arm as it was found; after Ctrl-C or a failure the arm is stopped."""
        leave(self._client, armed=self._armed, over=self._over)

    def _do(self, command: str, **args: Any) -> dict[str, Any]:
        return do(self._client, command, **args)


def do(client: CommandClient, command: str, **args: Any) -> dict[str, Any]:
    """The result of a command; CliError with the daemon's reason if it refuses."""
    reply = client.ask(command, args)
    if not reply["ok"]:
        raise CliError(BAD_INPUT, " ".join(str(reply.get("error")).split()))
    result: dict[str, Any] = reply.get("result") or {}
    return result


def load(client: CommandClient, plan: Mapping[str, Any]) -> None:
    """Load a plan; CliError if the daemon rejects it."""
    do(client, "plan", path=f"{plan['name']}.yaml", text=yaml.safe_dump(dict(plan)))


def leave(client: CommandClient, *, armed: bool, over: bool) -> None:
    """Leave the palms at rest; stop the arm if it was `armed` here or the plan is not `over`."""
    if not over and client.ask("hold")["ok"]:
        t_end = time.monotonic() + COMING_TO_REST_S
        while time.monotonic() < t_end and do(client, "status")["moving"]:
            time.sleep(LOOK_S)
    if armed or not over:
        client.ask("stop")


def can_move(client: CommandClient) -> None:
    """CliError if the daemon's arm is not armed and cannot be."""
    status = do(client, "status")
    if status["state"] not in ("ready", "tracking", "hold"):
        reasons = (f"{code}: {hint}" for code, hint in zip(status["faults"], status["hints"], strict=True))
        raise CliError(RIG_FAILED, f"the arm cannot be armed, the state is {status['state']}; {'; '.join(reasons)}")


def why(status: Status) -> str:
    """What holds or stops the motion, and what to do."""
    blocking = [
        f"{code}: {hint}"
        for code, severity, hint in zip(status["faults"], status["severities"], status["hints"], strict=True)
        if severity in ("hold", "stop")
    ]
    return "; ".join(blocking) or f"the state is {status['state']}: {status['cause']}"
