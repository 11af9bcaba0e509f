"""Reader of configurations and plans in YAML; reports all errors at once with their positions: `file:line:col: what`.

Only plain YAML is accepted: one document, no duplicate keys, no aliases, no merge keys, no tags, and no numbers in
misleading notation (octal `010`, sexagesimal `1:30`).
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from palmd.config.any_config import AnyConfig
from palmd.config.two_palms import Config, PlanSpec
from palmd.lookalikes import ascii_equivalent, describe_character, intended_number, is_letter, non_ascii_characters
from palmd.systems import LIVE, TWO_PALMS, for_two_palms_only, load_part

MAX_BYTES = 256_000  # real files have a few kB; parsing a megabyte takes seconds
MAX_DEPTH = 20
MAX_ERRORS = 100

_LINE_END = re.compile("\r\n|[\n\r\x85\u2028\u2029]")  # as PyYAML counts lines
_FIRST_HALF = re.compile(r"([-+\u2212]?\d+),\s*$")
_SECOND_HALF = re.compile(r"\d+(\.\d+)?([eE][-+]?\d+)?")

Loc = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)


class ConfigError(Exception):
    """A file that cannot be used; `errors` holds one `file:line:col: what` per error."""

    def __init__(self, errors: list[str]) -> None:
        super().__init__("\n".join(errors))
        self.errors = errors


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """A position in a file, counted from one."""

    line: int = 1
    column: int = 1


@dataclass(slots=True)
class Document:
    """A YAML file as plain data, with the positions of all keys and values (by their path from the top)."""

    path: Path
    text: str = ""
    data: Any = None
    values: dict[Loc, Place] = field(default_factory=dict)
    keys: dict[Loc, Place] = field(default_factory=dict)
    texts: dict[Loc, str] = field(default_factory=dict)  # scalars as written in the file
    problems: list[tuple[Place, str]] = field(default_factory=list)

    def place(self, loc: Loc) -> Place:
        """Position of the value at `loc`, or of the innermost enclosing value in the file."""
        while loc and loc not in self.values:
            loc = loc[:-1]
        return self.values.get(loc, Place())

    def line(self, place: Place, text: str) -> str:
        """One error line; line breaks in the text are replaced."""
        return f"{self.path}:{place.line}:{place.column}: {' '.join(text.splitlines())}"

    def error(self, problems: list[tuple[Place, str]]) -> ConfigError:
        """All problems in the order of the file, with the characters in their lines that only look like ASCII.

        Problems at one position keep their order.
        """
        lines = {place.line - before for place, _ in problems for before in (0, 1)}
        lookalikes = [
            (place, describe_character(odd.character))
            for odd in islice(non_ascii_characters(self.text), MAX_ERRORS)
            for place in [_place_at(self.text, odd.index)]
            if place.line in lines and (ascii_equivalent(odd.character) is not None or is_letter(odd.character))
        ]
        in_order = sorted(dict.fromkeys(problems + lookalikes), key=lambda problem: problem[0])
        return ConfigError([self.line(place, text) for place, text in in_order])


def read_document(path: Path, text: str | None = None) -> Document:
    """Read a YAML file as plain data; raises ConfigError if it is not valid YAML.

    With `text`, that is the content and `path` only the file's name. Content that is valid but not accepted (a
    duplicate key, an alias) is kept in `problems`, so that it is reported together with the errors of the models.
    """
    text = read_text(path) if text is None else text
    document = Document(path, text)
    document.problems += [
        (_place_at(text, odd.index), describe_character(odd.character))
        for odd in islice(non_ascii_characters(text), MAX_ERRORS)
        if odd.is_invisible and not odd.quoted
    ]
    try:
        node = _Loader(text).get_single_node()
    except yaml.MarkedYAMLError as error:
        raise document.error([*document.problems, _syntax_problem(text, error)]) from None
    except yaml.reader.ReaderError as error:
        character = error.character if isinstance(error.character, str) else chr(error.character)
        problem = _place_at(text, error.position), describe_character(character)
        raise document.error([*document.problems, problem]) from None
    if node is None:
        raise document.error([*document.problems, (Place(), "the file is empty")])
    document.data = _Reading(document).plain(node, ())
    return document


def is_plan(document: Document) -> bool:
    """Whether it is meant as a motion plan: whether it has the key `segments`."""
    return isinstance(document.data, dict) and "segments" in document.data


def parse(document: Document, model: type[Model]) -> Model:
    """The document as a validated model; raises ConfigError with all its errors."""
    problems = list(document.problems)
    try:
        spec = model.model_validate(document.data, context={"folder": document.path.parent.absolute()})
    except ValidationError as error:
        details = error.errors()
        problems += [_problem(document, model, detail) for detail in details[:MAX_ERRORS]]
        if len(details) > MAX_ERRORS:
            problems.append((Place(), f"{len(details) - MAX_ERRORS} more errors are not shown"))
    if problems:
        raise document.error(problems)
    return spec


def configured_system(document: Document) -> str:
    """The live system named in a configuration, two palms if none is named; raises ConfigError for any other."""
    rig = document.data.get("rig") if isinstance(document.data, dict) else None
    system = rig.get("system") if isinstance(rig, dict) else None
    known = [name for name in LIVE if name != TWO_PALMS]
    if system is None or system in known:
        return system or TWO_PALMS
    text = (
        f"rig.system: there is no system {system!r}; the systems are {', '.join(known)}, and two palms without this key"
    )
    raise document.error([(document.place(("rig", "system")), text)])


def parse_config(document: Document) -> AnyConfig:
    """The document as the configuration of its system; raises ConfigError as `parse` does."""
    config: AnyConfig = parse(document, load_part(LIVE[configured_system(document)].config))
    return config


def recorded_config(values: Any) -> AnyConfig:
    """A configuration from its values as recorded by a daemon; its paths are those of the daemon's machine.

    Raises ConfigError if this version of palmd cannot represent it.
    """
    name = Path("the daemon's configuration")
    try:
        system = values["rig"].get("system", TWO_PALMS)
        config: AnyConfig = load_part(LIVE[system].config).model_validate(values)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ConfigError([f"{name}: {str(error).splitlines()[0]}"]) from None
    return config


def load_config(path: Path) -> Config:
    """The configuration of two palms in a file; raises ConfigError, also for that of another system."""
    config = load_any_config(path)
    if not isinstance(config, Config):
        raise ConfigError([f"{path}: {for_two_palms_only(config.system)} ({LIVE[config.system].manual})"])
    return config


def load_any_config(path: Path) -> AnyConfig:
    """The configuration in a file, of any system; raises ConfigError."""
    document = read_document(path)
    if is_plan(document):
        text = "this is a motion plan; expected a configuration, which may name it (plan: FILE)"
        raise document.error([(Place(), text)])
    return parse_config(document)


def load_plan(path: Path) -> PlanSpec:
    """The motion plan in a file, validated except for its motion; raises ConfigError."""
    return parse(read_document(path), PlanSpec)


# --------------------------------------------------------------------------------------------- bytes to nodes


class _NotAllowed(yaml.MarkedYAMLError):
    """Valid YAML that is not accepted here."""

    def __init__(self, problem: str, event: yaml.Event) -> None:
        super().__init__(problem=problem, problem_mark=event.start_mark)  # type: ignore[arg-type]  # C twin


class _Loader(yaml.SafeLoader):
    """PyYAML's parser without constructs by which a short file can expand to a huge one."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _NotAllowed(f"aliases (*{event.anchor}) are not accepted; write the values out", event)
        if self.depth >= MAX_DEPTH:
            raise _NotAllowed("nested too deeply", event)
        self.depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node


def read_text(path: Path) -> str:
    """The content of a file before YAML parsing; raises ConfigError if it is not text, or too long."""
    document = Document(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except IsADirectoryError:
        raise document.error([(Place(), "this is a folder, not a file")]) from None
    except FileNotFoundError:
        raise document.error([(Place(), "no such file")]) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise document.error([(Place(), f"cannot be read: {reason}")]) from None
    if len(content) > MAX_BYTES:
        text = f"larger than {MAX_BYTES // 1000} kB: this is not a configuration or a plan"
        raise document.error([(Place(), text)])
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = _place_at(content[: error.start].decode("utf-8-sig", "replace"), error.start)
        raise document.error([(place, "not UTF-8 text; save the file as UTF-8")]) from None


def _place_at(text: str, position: int) -> Place:
    lines = _LINE_END.split(text[:position])
    return Place(len(lines), len(lines[-1]) + 1)


def _place(mark: yaml.Mark | None) -> Place:
    return Place() if mark is None else Place(mark.line + 1, mark.column + 1)


def _syntax_problem(text: str, error: yaml.MarkedYAMLError) -> tuple[Place, str]:
    place = _place(error.problem_mark or error.context_mark)
    lines = text.split("\n")
    line = lines[place.line - 1] if place.line <= len(lines) else ""
    indent = line[: len(line) - len(line.lstrip())]
    if "\t" in indent:
        return Place(place.line, indent.index("\t") + 1), "a tab in the indentation: use spaces"
    if isinstance(error, yaml.composer.ComposerError) and error.context:
        return place, "a second document begins here; a file holds one"
    if line[place.column - 1 : place.column] == "\t":
        return place, "a tab: use spaces"
    what = error.problem or "not understood"
    if isinstance(error, _NotAllowed):
        return place, what
    return place, f"not valid YAML: {what}" + (f" ({error.context})" if error.context else "")


# ---------------------------------------------------------------------------------------- nodes to plain data


class _Reading:
    """Converts nodes to plain data, and records positions and what is not allowed."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.scalars = yaml.constructor.SafeConstructor()

    def plain(self, node: yaml.Node, loc: Loc) -> Any:
        self.document.values[loc] = _place(node.start_mark)
        if isinstance(node, yaml.MappingNode) and node.tag == "tag:yaml.org,2002:map":
            return self._mapping(node, loc)
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return [self.plain(child, (*loc, index)) for index, child in enumerate(node.value)]
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, loc)
        self._problem(node, f"tags ({node.tag}) are not accepted")
        return None

    def _mapping(self, node: yaml.MappingNode, loc: Loc) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._problem(key_node, "a key must be a plain word")
                continue
            key = key_node.value
            if key_node.tag == "tag:yaml.org,2002:merge":
                self._problem(key_node, "merge keys (<<) are not accepted; write the keys out")
            elif key in values:
                first = self.document.keys[(*loc, key)]
                self._problem(key_node, f"{_dotted((*loc, key))}: this key is already in line {first.line}")
            else:
                self.document.keys[(*loc, key)] = _place(key_node.start_mark)
                values[key] = self.plain(value_node, (*loc, key))
        return values

    def _scalar(self, node: yaml.ScalarNode, loc: Loc) -> Any:
        text: str = node.value
        quoted = node.style is not None
        self.document.texts[loc] = f'"{text}"' if quoted else text
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        try:
            if kind in ("null", "bool", "int", "float"):
                value = getattr(self.scalars, f"construct_yaml_{kind}")(node)
                if kind in ("int", "float"):
                    self._refuse_odd_notation(node, value)
                return value
            if kind in ("str", "timestamp", "value"):
                return text
        except (ValueError, KeyError, OverflowError):
            self._problem(node, f"not a usable number: {_shortened(text)}")
            return text
        self._problem(node, f"tags ({node.tag}) are not accepted")
        return text

    def _refuse_odd_notation(self, node: yaml.ScalarNode, number: float) -> None:
        digits = node.value.lstrip("+-")
        if ":" in digits:
            self._problem(node, f"{node.value} is sexagesimal in YAML; write {number:g} if that is meant")
        elif isinstance(number, int) and len(digits) > 1 and digits[0] == "0" and digits[1] in "01234567_":
            decimal = ("-" if node.value.startswith("-") else "") + (digits.lstrip("0_") or "0")
            self._problem(node, f"{node.value} is octal in YAML ({number}); write {decimal} without the zero")

    def _problem(self, node: yaml.Node, text: str) -> None:
        self.document.problems.append((_place(node.start_mark), text))


# ------------------------------------------------------------------------------- validation errors in plain words


def _problem(document: Document, model: type[BaseModel], detail: ErrorDetails) -> tuple[Place, str]:
    loc = tuple(part for part in detail["loc"] if not str(part).startswith("<"))  # without the tags of segments
    kind = detail["type"]
    if kind == "missing":
        around = loc[:-1]
        if isinstance(loc[-1], int):
            return document.place(around), f"{_dotted(around)}: must have 2 entries; got {loc[-1]}"
        place = document.keys.get(around, document.place(around))
        return place, f"{_dotted(loc)}: is missing"
    if kind == "extra_forbidden":
        place = document.keys.get(loc, document.place(loc))
        comma = _decimal_comma(document, place, loc)
        return place, comma or f"{_dotted(loc)}: {_unknown_key(model, loc)}"
    while loc not in document.values:  # a part that exists only in the model, as for one number given in place of two
        loc = loc[:-1]
    place = document.values[loc]
    text = _in_words(document, loc, detail)
    return place, f"{_dotted(loc)}: {text}" if loc else text


def _unknown_key(model: type[BaseModel], loc: Loc) -> str:
    near = difflib.get_close_matches(str(loc[-1]), _known_keys(model, loc[:-1]), n=1)
    return "unknown key" + (f"; did you mean {near[0]}?" if near else "")


def _decimal_comma(document: Document, place: Place, loc: Loc) -> str:
    """What to write if a decimal comma has split a number into two entries; empty for another key."""
    lines = _LINE_END.split(document.text)
    line = lines[place.line - 1] if place.line <= len(lines) else ""
    first, second = _FIRST_HALF.search(line[: place.column - 1]), str(loc[-1])
    if first is None or not _SECOND_HALF.fullmatch(second):
        return ""
    written = f"{first[1]},{second}"
    number = intended_number(written)
    alternatives = [number or f"{first[1]}{second}"]
    if number and len(second) == 3:
        alternatives.append(f"{first[1]}{second}")
    return f"{_dotted(loc[:-1])}: a comma begins another entry; for {written} write {' or '.join(alternatives)}"


def _known_keys(model: type[BaseModel], section: Loc) -> list[str]:
    """The keys allowed in this section of the model, in any of its forms."""
    schema = _schema(model)
    forms = list(_forms(schema, schema))
    for part in section:
        parts = [form.get("items") if isinstance(part, int) else form.get("properties", {}).get(part) for form in forms]
        forms = [form for inner in parts if inner is not None for form in _forms(inner, schema)]
    return sorted({key for form in forms for key in form.get("properties", {})})


@functools.cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def _forms(part: dict[str, Any], schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The forms of a part of a JSON schema: references and alternatives resolved."""
    if "$ref" in part:
        yield from _forms(schema["$defs"][part["$ref"].removeprefix("#/$defs/")], schema)
    elif alternatives := part.get("anyOf", part.get("oneOf")):
        for alternative in alternatives:
            yield from _forms(alternative, schema)
    else:
        yield part


_BOUNDS = {
    "greater_than": ("gt", "more than"), "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"), "less_than_equal": ("le", "at most"),
    "too_short": ("min_length", "at least"), "too_long": ("max_length", "at most"),
}  # fmt: skip
_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "model_type": "a block of keys and values",
    "model_attributes_type": "a block of keys and values",
}


def _in_words(document: Document, loc: Loc, detail: ErrorDetails) -> str:
    """Pydantic's error in words that need no knowledge of pydantic: what is allowed, what was found."""
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    got = _got(document, loc, value)
    if kind in ("value_error", "assertion_error"):
        return str(context["error"])
    if value is None:
        return "has no value: write one or leave the key out" if loc else "the file holds no keys"
    if kind in _EXPECTED:
        return f"must be {_EXPECTED[kind]}; got {got}{_advice(kind, value, document.texts.get(loc, ''))}"
    if kind == "finite_number":
        return f"must be a finite number; got {got}"
    bound, words = _BOUNDS.get(kind, ("", ""))
    if kind in ("too_short", "too_long"):
        return f"must have {words} {context[bound]} entries; got {context['actual_length'] or len(value)}"
    if bound:
        return f"must be {words} {context[bound]:g}; got {got}"
    if kind == "literal_error":
        return f"must be one of {context['expected'].replace(chr(39), '')}; got {got}"
    if kind == "string_too_short":
        return "must not be empty"
    if kind == "string_too_long":
        return f"must have at most {context['max_length']} characters; got {len(value)}"
    return detail["msg"]


def _got(document: Document, loc: Loc, value: Any) -> str:
    if isinstance(value, dict):
        return "a block of keys and values"
    if isinstance(value, list):
        return "a list"
    written = _shortened(document.texts.get(loc, str(value)))
    if isinstance(value, bool) and written.lower() not in ("true", "false"):
        return f"{written}, which YAML reads as {str(value).lower()}"
    return f"the text {written}" if isinstance(value, str) else written


def _advice(kind: str, value: Any, written: str) -> str:
    if kind == "string_type":
        return f'; put it in quotes: "{_shortened(written)}"' if not isinstance(value, (dict, list)) else ""
    if not isinstance(value, str) or kind not in ("float_type", "int_type"):
        return ""
    number = intended_number(value)
    if not number:
        return ""
    if written == f'"{number}"':
        return "; leave out the quotes"
    return f"; write {float(number)} or {number}" if "e" in number else f"; write {number}"


def _shortened(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "…"


def _dotted(loc: Loc) -> str:
    return ".".join(map(str, loc))
