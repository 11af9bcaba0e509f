"""Events in, estimates out: filters, banks of them, and what they have learnt of the object."""

from __future__ import annotations

from typing import Literal, get_args

from palmd.events import RigDescription
from palmd.observer.filters import ExtendedFilters, ShapeFilters
from palmd.observer.live import BankObserver

ObserverName = Literal["shape", "extended"]
OBSERVERS: tuple[str, ...] = get_args(ObserverName)

EXTENDED_BANK, SHAPE_BANK = 24, 32  # multiples of model.compiled.BLOCK


def make(name: ObserverName, rig: RigDescription, seed: int = 0) -> BankObserver:
    """The observer called `name` for `rig`; takes seconds when its C has to be compiled first."""
    filters = ExtendedFilters(rig, EXTENDED_BANK) if name == "extended" else ShapeFilters(rig, SHAPE_BANK)
    return BankObserver(filters, rig, seed)
