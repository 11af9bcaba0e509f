"""Rules of PlotJuggler's ZeroMQ source, written from its documentation and source code, not from palmd's."""

import re

import msgpack

NUMBER = re.compile(rb"[0-9]+(\.[0-9]+)?")  # accepted completely by C's strtod in any locale


def problems(frames):
    """Reasons why it would drop or misread a message; empty if none."""
    if len(frames) != 3:
        return [f"{len(frames)} frames"]
    topic, payload, seconds = frames
    if not re.fullmatch(rb"[a-z]+(/[a-z0-9_]+)*", topic):
        return [f"topic {topic!r}"]
    if not NUMBER.fullmatch(seconds) or not 1e9 < float(seconds) < 1e10:
        return [f"third frame {seconds!r}: not Unix seconds"]
    try:
        fields = msgpack.unpackb(payload, strict_map_key=True, raw=False)
    except ValueError as error:
        return [f"payload: {error!r}"]
    if not isinstance(fields, dict):
        return [f"top level is a {type(fields).__name__}"]
    return list(_faults("", fields))


def _faults(where, value):
    if isinstance(value, dict):
        for key, inner in value.items():
            if not isinstance(key, str):
                yield f"{where}/{key!r}: key is not a string"
            yield from _faults(f"{where}/{key}", inner)
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            if isinstance(inner, dict | list):
                yield f"{where}[{i}]: nested in a list"
            else:
                yield from _faults(f"{where}[{i}]", inner)
    elif not isinstance(value, bool | int | float | str):
        yield f"{where}: {type(value).__name__}"


def series(topic, fields, prefix=""):
    """Names and values of the series that can be plotted."""
    for name, value in fields.items():
        if isinstance(value, dict):
            yield from series(topic, value, f"{prefix}{name}/")
        elif isinstance(value, list):
            yield from (f"{topic}/{prefix}{name}[{i}]" for i in range(len(value)))
        elif not isinstance(value, str):
            yield f"{topic}/{prefix}{name}"
