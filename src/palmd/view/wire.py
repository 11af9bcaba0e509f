"""What goes between server and page. Pure.

To the page: text frames are JSON maps `{hello: …}` and `{answer: …}`; binary frames are batches, a msgpack list
`[frame, lost, commandable, [[topic, payload], …]]` with each payload as the daemon sent it, so that nothing is decoded
on the way. From the page: JSON maps, first `{token}`, with a `page` by which it is known again after a reload, then
`{id, cmd}`, with `args` where the command has some.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import msgpack

from palmd.view.feed import Payload

Argument = str | int | float
_MARK = re.compile("[0-9a-z]{1,12}")


@dataclass(frozen=True, slots=True)
class Order:
    """A command as the page asks for it; `id` is the page's own and comes back with the answer.

    What the arguments may be the daemon knows.
    """

    id: int
    command: str
    args: dict[str, Argument] = field(default_factory=dict)


def batch(frame: int, lost: int, commandable: bool, messages: Iterable[Payload]) -> bytes:
    """All messages of one frame; `lost` counts the frames that this page was too slow for."""
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
    """The first words: who is here, whether this page may give commands, in which state each applies, and its name.

    `library` is the key by which this page may fetch runs and reports, empty for a page that may not.
    """
    fields = {"version": version, "operator": operator, "publish": publish, "command": command, "allowed": allowed}
    return json.dumps({"hello": fields | {"client": client, "library": library}})


def answer(order: Order, error: str | None, result: Mapping[str, Any] | None = None) -> str:
    """What became of an order."""
    told = {"id": order.id, "cmd": order.command, "error": error} | ({} if result is None else {"result": result})
    return json.dumps({"answer": told})


def token_in(text: str | bytes) -> tuple[str, str] | None:
    """The token in a page's first message and the page's own mark, each empty when it has none.

    None when that is no such message.
    """
    message = _map(text)
    if message is None or not {"token"} <= message.keys() <= {"token", "page"}:
        return None
    token, page = message["token"], message.get("page", "")
    if not isinstance(token, str | None) or not isinstance(page, str) or not (page == "" or _MARK.fullmatch(page)):
        return None
    return token or "", page


def order_in(text: str | bytes) -> Order | None:
    """The order in a later message, None when there is none."""
    message = _map(text)
    if message is None or type(message.get("id")) is not int or not isinstance(message.get("cmd"), str):
        return None
    args = message.get("args", {})
    if not isinstance(args, dict) or not all(map(_is_argument, (*args, *args.values()))):
        return None
    return Order(message["id"], message["cmd"], args)


def _is_argument(value: object) -> bool:
    """Whether msgpack can carry it: text of whole characters, or a number that is not too long."""
    if isinstance(value, str):
        return not any("\ud800" <= letter <= "\udfff" for letter in value)
    return isinstance(value, float) or (isinstance(value, int) and abs(value) < 1 << 53)


def _map(text: str | bytes) -> dict[str, Any] | None:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None
