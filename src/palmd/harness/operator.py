"""What an operator does: keeps the palms moving, or runs one plan on a running daemon and looks on."""

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
"""The lease that the client of a `PlanRun` declares: its questions renew it, and with its end the palms are held."""
PROGRESS_S = 1.0
STANDING_S = 5.0  # for the palms to come to a stand when they are held
HELD_S = 30.0  # that a hold may last: until then somebody may put the object back and start again


class Operator:
    """Brings the palms to move and keeps them moving, as somebody who looks at the bus would. Pure.

    When somebody else holds or stops them it takes its hands off until they are started again; when somebody else
    loads another plan, for good.
    """

    def __init__(self) -> None:
        self.state: Status = {}
        self.motion: Status = {}
        self._hands_off = False
        self._plan, self._taken_over = "", False  # somebody else has loaded another plan
        self._t_told = -AGAIN_S
        self._wanted: str | None = None
        self._t_wanted = 0.0

    @property
    def moves(self) -> bool:
        """Whether the palms follow a plan."""
        return self.state.get("state") == "tracking" and self.motion.get("segment", -1) >= 0

    def take(self, topic: str, fields: Status) -> None:
        """Every palm/state and palm/motion."""
        if topic in MOTIONS:
            self.motion = fields
            plan = fields.get("plan", "")
            self._plan = self._plan or plan
            self._taken_over |= plan not in ("", self._plan)
        elif topic == "palm/state":
            self._hands_off |= fields["wish"] not in ("", self.state.get("wish"))
            self.state = fields

    def resume(self) -> None:
        """Whoever held or stopped the palms wants them to move again."""
        self._hands_off = False

    def decide(self, t: float) -> str | None:
        """The command to give at t (s), None for none.

        After a hold or a fault it waits until things have been calm for `CALM_S`, and never hurries.
        """
        if self.moves:
            self._hands_off = False
        wanted = None if self._hands_off or self._taken_over else self._wish()
        if wanted != self._wanted:
            self._wanted, self._t_wanted = wanted, t
        patience = 0.0 if wanted == "arm" else CALM_S
        if wanted is None or t - self._t_wanted < patience or t - self._t_told < AGAIN_S:
            return None
        self._t_told = t
        return wanted

    def _wish(self) -> str | None:
        return _next(self.state.get("state"), self.state.get("severities", ()), moves=self.moves)


def still_wanted(command: str, status: Status) -> bool:
    """Whether the daemon's own `status` calls for a command that an operator would give by what the bus has brought.

    On a busy machine that may be seconds old, and somebody may have held or stopped the palms since.
    """
    moves = status["segment"] >= 0
    return not status["wish"] and _next(status["state"], status["severities"], moves=moves) == command


def _next(state: str | None, severities: Iterable[str], *, moves: bool) -> str | None:
    """What leads on from a state, if anything does."""
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
    """One plan on a running daemon: load, arm, start, look on, leave at rest.

    Arms the arm if that has not been done, and then stops it in the end; a daemon that tracked before tracks on.
    """

    def __init__(
        self,
        client: CommandClient,
        listen: Callable[[float], None],
        told: Callable[[Status, float], str],
        *,
        resumes: Callable[[Status], bool] | None = None,
    ) -> None:
        """`listen(t_end)` takes what is published until t_end (s, monotonic clock).

        `told(status, seconds)` is how far it has come, in words, for an error. `resumes(status)` is asked
        whether a hold ends that nobody asked for and whose cause is gone; True only when no hand is near the palms.
        Without it none ends so.
        """
        self._resumes = resumes
        self.seconds = 0.0
        self._client, self._listen, self._told = client, listen, told
        self._armed = self._over = False

    def begin(self, plan: Mapping[str, Any]) -> None:
        """Hand the plan over, arm and start; CliError with the daemon's own words when it refuses."""
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

    def watch(self, stop: StopRequest, progress: Callable[[Status, float], str]) -> Status:
        """The status when it is over or `stop` is made; `progress(status, seconds)` is printed now and then.

        CliError when somebody or a fault has ended it, or it stays held.
        """
        begun = time.monotonic()
        t_progress = t_going = begun
        while True:
            self._listen(time.monotonic() + LOOK_S)
            status, t = self._do("status"), time.monotonic()
            self.seconds = t - begun
            if status["state"] not in ("tracking", "hold"):
                raise CliError(RIG_FAILED, f"{self._told(status, self.seconds)}; {why(status)}")
            if status["state"] == "tracking" and status["over"]:
                self._over = True
                return status
            if stop.made:
                return status
            if status["state"] == "tracking":
                t_going = t
            elif self._resumes and still_wanted("start", status) and self._resumes(status):
                self._client.ask("start")
                t_going = time.monotonic()
            if t > t_going + HELD_S:
                raise CliError(RIG_FAILED, f"held for {HELD_S:g} s, so given up; {why(status)}")
            if t >= t_progress:
                t_progress = t + PROGRESS_S
                print(progress(status, self.seconds), file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the palms standing, and the arm as it was found; after Ctrl-C or a failure it is stopped."""
        leave(self._client, armed=self._armed, over=self._over)

    def _do(self, command: str, **args: Any) -> dict[str, Any]:
        return do(self._client, command, **args)


def do(client: CommandClient, command: str, **args: Any) -> dict[str, Any]:
    """The result of a command; CliError with the daemon's own words when it refuses."""
    reply = client.ask(command, args)
    if not reply["ok"]:
        raise CliError(BAD_INPUT, " ".join(str(reply.get("error")).split()))
    result: dict[str, Any] = reply.get("result") or {}
    return result


def load(client: CommandClient, plan: Mapping[str, Any]) -> None:
    """Hand a plan over; CliError when the daemon finds fault with it."""
    do(client, "plan", path=f"{plan['name']}.yaml", text=yaml.safe_dump(dict(plan)))


def leave(client: CommandClient, *, armed: bool, over: bool) -> None:
    """Leave the palms standing, and stop the arm if it was `armed` here or all is not `over`."""
    if not over and client.ask("hold")["ok"]:
        t_end = time.monotonic() + STANDING_S
        while time.monotonic() < t_end and do(client, "status")["moving"]:
            time.sleep(LOOK_S)
    if armed or not over:
        client.ask("stop")


def can_move(client: CommandClient) -> None:
    """CliError when the daemon's arm is neither armed nor can be."""
    status = do(client, "status")
    if status["state"] not in ("ready", "tracking", "hold"):
        told = (f"{code}: {hint}" for code, hint in zip(status["faults"], status["hints"], strict=True))
        raise CliError(RIG_FAILED, f"the arm cannot be armed, the state is {status['state']}; {'; '.join(told)}")


def why(status: Status) -> str:
    """What holds or stops it, and what to do."""
    grave = [
        f"{code}: {hint}"
        for code, severity, hint in zip(status["faults"], status["severities"], status["hints"], strict=True)
        if severity in ("hold", "stop")
    ]
    return "; ".join(grave) or f"the state is {status['state']}: {status['cause']}"
