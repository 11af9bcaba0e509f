"""Protocol between server and page. Pure.

To the page: text frames are JSON maps `{hello: …}` and `{answer: …}`; binary frames are batches, a msgpack list
`[frame, lost, commandable, [[topic, payload], …]]` with undecoded payloads of the daemon. From the page: JSON maps,
first `{token}`, with an id `page` that identifies the page after a reload, then `{id, cmd}`, with `args` if the command
has any.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import msgpack

from palmd.view.daemon_link import Payload

Argument = str | int | float
_PAGE_ID = re.compile("[0-9a-z]{1,12}")


@dataclass(frozen=True, slots=True)
class Order:
    """A command of the page; `id` is chosen by the page and returned with the answer.

    The daemon checks the arguments.
    """

    id: int
    command: str
    args: dict[str, Argument] = field(default_factory=dict)


def batch(frame: int, lost: int, commandable: bool, messages: Iterable[Payload]) -> bytes:
    """Encode the messages of one frame; `lost` counts the frames that were dropped because this page was too slow."""
    return cast(bytes, msgpack.packb([frame, lost, commandable, list(messages)]))


def hello(
    version: str,
    operator: bool,
    publish: str,
    command: str,
    allowed: Mapping[str, Sequence[str]],
    client: str,
    library: str = "",
) -> str:
    """The first message: version, whether the page may send commands, the states in which each applies, client name.

    `library` is the key for downloads of runs and reports, empty for a page without permission.
    """
    fields = {"version": version, "operator": operator, "publish": publish, "command": command, "allowed": allowed}
    return json.dumps({"hello": fields | {"client": client, "library": library}})


def answer(order: Order, error: str | None, result: Mapping[str, Any] | None = None) -> str:
    """Encode the answer to an order."""
    fields = {"id": order.id, "cmd": order.command, "error": error} | ({} if result is None else {"result": result})
    return json.dumps({"answer": fields})


def token_in(text: str | bytes) -> tuple[str, str] | None:
    """The token and the page id in a page's first message, each empty if missing; None for other messages."""
    message = _map(text)
    if message is None or not {"token"} <= message.keys() <= {"token", "page"}:
        return None
    token, page = message["token"], message.get("page", "")
    if not isinstance(token, str | None) or not isinstance(page, str) or not (page == "" or _PAGE_ID.fullmatch(page)):
        return None
    return token or "", page


def order_in(text: str | bytes) -> Order | None:
    """The order in a later message, None for other messages."""
    message = _map(text)
    if message is None or type(message.get("id")) is not int or not isinstance(message.get("cmd"), str):
        return None
    args = message.get("args", {})
    if not isinstance(args, dict) or not all(map(_is_argument, (*args, *args.values()))):
        return None
    return Order(message["id"], message["cmd"], args)


def _is_argument(value: object) -> bool:
    """Whether msgpack can encode it: text without surrogates, or a number that is not too large."""
    if isinstance(value, str):
        return not any("\ud800" <= letter <= "\udfff" for letter in value)
    return isinstance(value, float) or (isinstance(value, int) and abs(value) < 1 << 53)


def _map(text: str | bytes) -> dict[str, Any] | None:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None
