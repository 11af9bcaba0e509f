"""The stable interfaces of releases: bus fields, commands, configuration keys, the Python API. `--write` stores them.

The stored copy is tests/data/promises.json; a test compares it with the code. A stored name must not disappear or
change its unit before the next major release; new names are added by storing the copy again.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from palmd import api
from palmd.cli.table import COMMANDS, RENAMED, SHORT, load_module, parser_of
from palmd.config.fields import Strict
from palmd.daemon.commands import COMMANDS as REQUESTS
from palmd.quantities import STAMP
from palmd.systems import LIVE, load_part
from palmd.topics import RIG_TOPICS, TOPICS

STORED = Path(__file__).parent.parent / "tests/data/promises.json"


def promised() -> dict[str, Any]:
    """The interfaces in the present code."""
    commands = {command.name: sorted(_options(command)) for command in COMMANDS if command.module}
    return {
        "fields of every message": [quantity.name for quantity in STAMP],
        "topics": {
            topic.name: {quantity.name: [quantity.kind, quantity.unit] for quantity in topic.quantities}
            for topic in (*TOPICS, *RIG_TOPICS)
        },
        "requests": {name: [each.name for each in spec.arguments] for name, spec in REQUESTS.items()},
        "commands": commands | {short: commands[name] for short, name in SHORT.items()},
        "former commands": dict(RENAMED),
        "configuration": {name: sorted({*_keys(load_part(live.config))}) for name, live in LIVE.items()},
        "api": {name: _parameters(getattr(api, name)) for name in sorted(api.__all__)},
        "exit status": {"0": "success", "1": "the input is wrong", "2": "usage", "3": "the rig failed"},
    }


def broken(stored: Any, now: Any, where: str = "") -> Iterator[str]:
    """Names of the stored copy that are missing or different now, a line each; additions are ignored."""
    if isinstance(stored, dict):
        for name, part in stored.items():
            if not isinstance(now, dict) or name not in now:
                yield f"{where}{name} is missing"
            else:
                yield from broken(part, now[name], f"{where}{name}: ")
    elif isinstance(stored, list) and not _is_kind(stored):
        yield from (f"{where}{each} is missing" for each in stored if each not in now)
    elif stored != now:
        yield f"{where}was {stored}, is {now}"


def _is_kind(values: list[Any]) -> bool:
    """Whether the list is a field's kind and unit."""
    return len(values) == 2 and values[0] in _KINDS


_KINDS = {quantity.kind for topic in (*TOPICS, *RIG_TOPICS) for quantity in topic.quantities}


def _options(command: Any) -> Iterator[str]:
    for action in parser_of(command, load_module(command))._actions:
        yield from (
            (each for each in action.option_strings if each.startswith("--"))
            if action.option_strings
            else (str(action.metavar or action.dest),)
        )


def _keys(model: type[BaseModel], head: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield f"{head}{name}"
        for inner in _models(field.annotation):
            yield from _keys(inner, f"{head}{name}.")


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, Strict):
        yield annotation
    for each in getattr(annotation, "__args__", ()):
        yield from _models(each)


def _parameters(target: Any) -> list[str]:
    """The parameters of a function, or the public names of a class."""
    if inspect.isclass(target):
        return sorted(
            name for name in {*dir(target), *getattr(target, "__annotations__", {})} if not name.startswith("_")
        )
    return list(inspect.signature(target).parameters)


def main() -> int:
    """Print broken promises; with `--write` store the present interfaces."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"store the present interfaces in {STORED.name}")
    now = promised()
    if parser.parse_args().write:
        STORED.write_text(json.dumps(now, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    lines = list(broken(json.loads(STORED.read_text(encoding="utf-8")), now))
    print("\n".join(lines) or "all promises are kept")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
