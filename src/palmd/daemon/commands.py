"""Protocol of the command socket: the table of commands, and a parser for untrusted input. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import msgpack

from palmd.keys import Role
from palmd.system.mechanism import JOINTS

REQUEST_BYTES_MAX = 64 * 1024

_SCALARS = (str, bytes, int, float, bool, type(None))
_ID_LENGTH_MAX = 256
SENDER_LENGTH_MAX = 100
_KEYS = ("id", "cmd", "args", "from", "client", "lease_s")


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a command; `low` and `high` bound a number, `longest` the number of characters of a text."""

    name: str
    kind: Literal["number", "text", "flag"]
    meaning: str
    required: bool = False
    low: float = -math.inf
    high: float = math.inf
    longest: int = REQUEST_BYTES_MAX


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """One row of the table of commands."""

    does: str
    arguments: tuple[Argument, ...] = ()
    by_hand: bool = True  # whether operators give it, as opposed to programs
    role: Role = Role.OPERATE  # role that a client with a key needs
    moves: bool = False  # whether only the client in control may give it

    @property
    def logged(self) -> bool:
        """Whether `palm/log` records that it was given."""
        return self.by_hand and self.role is Role.OPERATE


TAKE = Argument("take", "flag", "true: first take control from the client that has it")
LEASE_MAX_S = 60.0

JOG_STEP_MAX_DEG = 0.5
JOG_WHOLE_MAX_DEG = 180.0

COMMANDS: dict[str, CommandSpec] = {
    "status": CommandSpec("returns state, faults, plan, angles and estimate", role=Role.WATCH),
    "arm": CommandSpec("from ready: starts tracking and holds the present pose", (TAKE,), moves=True),
    "start": CommandSpec("moves smoothly to the plan's start and runs it; resumes after a hold", (TAKE,), moves=True),
    "hold": CommandSpec("stops the motion along its path; tracking goes on", (TAKE,)),
    "stop": CommandSpec("planned stop, back to ready", (TAKE,)),
    "reset": CommandSpec(
        "clears latched faults whose cause is gone, and a faulted controller; never an e-stop", (TAKE,), moves=True
    ),
    "plan": CommandSpec(
        "validates and loads another plan; not while moving",
        (
            Argument(
                "path", "text", "the plan's file; without `text`, a file beside the configured plan", required=True
            ),
            Argument("text", "text", "the file's content"),
            TAKE,
        ),
        moves=True,
    ),
    "jog": CommandSpec(
        "turns the palms by small steps; they stop if the next step does not arrive within 200 ms",
        tuple(
            Argument(f"{joint}_deg", "number", f"step of {joint}", low=-JOG_STEP_MAX_DEG, high=JOG_STEP_MAX_DEG)
            for joint in JOINTS
        )
        + tuple(
            Argument(
                f"whole_{joint}_deg",
                "number",
                f"sum of this and all following steps of {joint}: all of it must be within the limits",
                low=-JOG_WHOLE_MAX_DEG,
                high=JOG_WHOLE_MAX_DEG,
            )
            for joint in JOINTS
        )
        + (TAKE,),
        moves=True,
    ),
    "alive": CommandSpec(
        "renews the client's lease; with take, takes control and moves nothing", (TAKE,), by_hand=False
    ),
    "note": CommandSpec(
        "writes a note with the present time into the recording",
        (Argument("text", "text", "the note; 1000 characters at most", required=True, longest=1000),),
    ),
    "new_object": CommandSpec("starts a new object: the observer forgets the present one (two palms only)"),
    "recorder": CommandSpec(
        "reports the recorder's state to the daemon; the recorder sends it each second",
        (
            Argument("bytes", "number", "bytes in the file", required=True, low=0.0),
            Argument("messages", "number", "messages in the file", required=True, low=0.0),
            Argument("lost", "number", "messages lost since the recorder's start", True, low=0.0),
            Argument("path", "text", "of the file; absent while there is none"),
            Argument("process", "number", "the recorder's process number", low=0.0),
            Argument("problem", "text", "why the recorder cannot write; absent when it can"),
        ),
        by_hand=False,
    ),
}


@dataclass(frozen=True, slots=True)
class Request:
    """A valid command. `route` is the reply route, opaque here; None if no reply is expected.

    `who` describes the sender: its own text, and its key's name if the bus has keys. `client` is the text that
    identifies the sender over several connections, empty for none; `member` is its key's name; `lease_s` is how long
    (s) its control lasts after each of its requests, None if this request does not declare it.
    """

    name: str
    args: dict[str, Any] = field(default_factory=dict)
    id: Any = None
    route: tuple[bytes, ...] | None = None
    who: str = ""
    client: str = ""
    member: str = ""
    lease_s: float | None = None


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request: a result or an error."""

    request: Request
    error: str | None = None
    result: dict[str, Any] | None = None

    def fields(self) -> dict[str, Any]:
        """The map that is sent."""
        return reply_fields(self.request.id, self.error, self.result)


class CommandError(ValueError):
    """A message that is not a valid command; `id` is its identity if it could be read, else None."""

    def __init__(self, text: str, id: Any = None) -> None:
        super().__init__(text)
        self.id = id


def reply_fields(id: Any, error: str | None, result: dict[str, Any] | None = None) -> dict[str, Any]:
    """The reply `{id, ok, error?, result?}`."""
    fields: dict[str, Any] = {"id": id, "ok": error is None}
    if error is not None:
        fields["error"] = error
    if result is not None:
        fields["result"] = result
    return fields


def parse(payload: bytes, route: tuple[bytes, ...] | None = None) -> Request:
    """The request in a msgpack map `{id, cmd, args, from?, client?, lease_s?}`; raises CommandError for anything else.

    `client` and `lease_s` may also be given among the `args`.
    """
    if len(payload) > REQUEST_BYTES_MAX:
        raise CommandError(f"a command has {REQUEST_BYTES_MAX} bytes at most, not {len(payload)}")
    try:
        message = msgpack.unpackb(payload)
    except Exception as error:  # msgpack raises many kinds of exceptions for invalid data
        raise CommandError(f"not a msgpack map {{id, cmd, args}}: {error or type(error).__name__}") from None
    if not isinstance(message, dict):
        raise CommandError(f"expected a map {{id, cmd, args}}, got {_type_name(message)}")
    id = _echoable_id(message.get("id"))
    unknown = [key for key in message if key not in _KEYS]
    if unknown:
        raise CommandError(f"unknown key {_shown(unknown[0])}; a command has {', '.join(_KEYS)}", id)
    name = message.get("cmd")
    if not isinstance(name, str) or name not in COMMANDS:
        raise CommandError(f"unknown command {_shown(name)}; the commands are {', '.join(COMMANDS)}", id)
    args = message.get("args")
    if isinstance(args, dict):
        for key in [key for key in ("client", "lease_s") if key in args]:
            message.setdefault(key, args.pop(key))
    sender, client = (_text_of(key, message.get(key, ""), id) for key in ("from", "client"))
    args = _arguments(name, {} if args is None else args, id)
    return Request(name, args, id, route, sender, client, lease_s=_lease(message.get("lease_s"), id))


def _text_of(key: str, value: Any, id: Any) -> str:
    """Check the text in `from` or `client`."""
    if not isinstance(value, str) or len(value) > SENDER_LENGTH_MAX or not value.isprintable():
        raise CommandError(f"{key} must be printable text of {SENDER_LENGTH_MAX} characters at most", id)
    return value


def _lease(value: Any, id: Any) -> float | None:
    """The lease that a request declares (s), None for none."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= LEASE_MAX_S:
        raise CommandError(f"lease_s must be a number above 0 and {LEASE_MAX_S:g} at most, got {_shown(value)}", id)
    return float(value)


def _echoable_id(id: Any) -> Any:
    """The request's id if it may be echoed, that is a scalar that is not too long; else None."""
    if not isinstance(id, _SCALARS) or (isinstance(id, str | bytes) and len(id) > _ID_LENGTH_MAX):
        return None
    return id


def _arguments(command: str, args: Any, id: Any) -> dict[str, Any]:
    if not isinstance(args, dict):
        raise CommandError(f"{command}: args must be a map, got {_type_name(args)}", id)
    known = {argument.name: argument for argument in COMMANDS[command].arguments}
    for name, value in args.items():
        argument = known.get(name)
        if argument is None:
            choices = f"the arguments are {', '.join(known)}" if known else "it takes none"
            raise CommandError(f"{command}: unknown argument {_shown(name)}; {choices}", id)
        problem = _problem(argument, value)
        if problem is not None:
            raise CommandError(f"{command}: {name} {problem}", id)
    missing = [name for name, argument in known.items() if argument.required and name not in args]
    if missing:
        raise CommandError(f"{command}: {missing[0]} is missing", id)
    return args


def _problem(argument: Argument, value: Any) -> str | None:
    if argument.kind == "flag":
        if not isinstance(value, bool):
            return f"must be true or false, got {_shown(value)}"
    elif argument.kind == "text":
        if not isinstance(value, str) or not value or "\0" in value:
            return f"must be text, got {_shown(value)}"
        if len(value) > argument.longest:
            return f"must have {argument.longest} characters at most, not {len(value)}"
    elif isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return f"must be a finite number, got {_shown(value)}"
    elif not argument.low <= value <= argument.high:
        return f"must be {argument.low:g} to {argument.high:g}, got {value:g}"
    return None


def _type_name(value: Any) -> str:
    return {list: "a list", str: "text", bytes: "bytes", type(None): "nothing"}.get(
        type(value), f"a {type(value).__name__}"
    )


def _shown(value: Any) -> str:
    if not isinstance(value, _SCALARS):
        return _type_name(value)
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "…"
