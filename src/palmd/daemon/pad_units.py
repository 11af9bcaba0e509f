"""Complete the configuration with the units that pads report; read once before the daemon starts."""

from __future__ import annotations

from typing import TypeVar

from palmd.config.any_config import AnyConfig
from palmd.config.pads import AnyPads
from palmd.devices.pad import inspect_pad

Configured = TypeVar("Configured", bound=AnyConfig)


def with_reported_units(config: Configured) -> Configured:
    """The configuration with the units that it leaves to the pads' devices; opens each device briefly.

    A device that is not present changes nothing: it is queried when its port is opened.
    """
    pads = getattr(config, "pads", None)
    if not isinstance(pads, AnyPads):
        return config
    each = {palm: getattr(pads, palm) for palm in type(pads).model_fields}
    found = {palm: inspect_pad(pad).config for palm, pad in each.items()}
    if all(found[palm] is pad for palm, pad in each.items()):
        return config
    return config.model_copy(update={"pads": pads.model_copy(update=found)})
