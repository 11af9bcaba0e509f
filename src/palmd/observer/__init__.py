"""Events in, estimates out: filters, banks of them, and what they have learnt of the object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, get_args

from palmd.events import ObserverName
from palmd.observer.noise import map_as_noise
from palmd.observer.observer import Observer
from palmd.observer.smoothing import Smoothing
from palmd.system.description import RigDescription

if TYPE_CHECKING:
    from palmd.observer.simulated_smoother import Simulated
    from palmd.outlinefile import Outline

OBSERVERS: tuple[str, ...] = get_args(ObserverName)

__all__ = ["OBSERVERS", "Observer", "ObserverName", "Simulated", "Smoothing", "make"]


def __getattr__(name: str) -> Any:
    """`Simulated` is loaded when it is wanted: a daemon's smoother is in another process."""
    if name != "Simulated":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from palmd.observer.simulated_smoother import Simulated

    return Simulated


EXTENDED_BANK, SHAPE_BANK, KNOWN_BANK = 24, 32, 24  # multiples of model.compiled.BLOCK


def flat_only(name: ObserverName) -> str:
    """Why an observer cannot be had for curved palms; empty where it can."""
    return "" if name == "shape" else f"the observer {name} knows flat palms only; the observer shape knows curved ones"


def make(
    name: ObserverName,
    rig: RigDescription,
    seed: int = 0,
    smoothing: Smoothing | None = None,
    outlines: Sequence[Outline] = (),
) -> Observer:
    """The observer called `name` for `rig`; takes seconds when its C has to be compiled first.

    `smoothing` says where the smoother of a shape map runs; without it there is none, nor for other observers. With
    `outlines`, which are for shape maps only, the object is one of these or none, and needs no smoother. Raises
    ValueError for curved palms where an observer knows flat ones only (`flat_only`).
    """
    if rig.curved and (reason := flat_only(name)):
        raise ValueError(reason)
    rig = map_as_noise(rig)
    # each is loaded where it is wanted
    if name == "quasistatic":
        from palmd.observer.quasistatic import QuasistaticObserver

        return QuasistaticObserver(rig)
    from palmd.observer.bank_observer import BankObserver

    if name == "extended":
        from palmd.observer.filters.extended import ExtendedFilters

        return BankObserver(ExtendedFilters(rig, EXTENDED_BANK), rig, seed)
    if outlines:
        from palmd.observer.recogniser import Recogniser

        recogniser = Recogniser(outlines, rig)
        return BankObserver(recogniser.filters, rig, seed, recogniser)
    from palmd.observer.filters.shape_map import ShapeFilters

    filters = ShapeFilters(rig, SHAPE_BANK)
    if smoothing is None:
        return BankObserver(filters, rig, seed)
    from palmd.model.smoothing import ORDER
    from palmd.observer.filters.base import NOT_OVERCONFIDENT
    from palmd.observer.handover import Handover
    from palmd.observer.returning_object import ReturningObject, SmoothedFilters
    from palmd.observer.smoother_link import SmootherLink

    known, single = (ShapeFilters(rig, size, order=ORDER, overconfidence=NOT_OVERCONFIDENT) for size in (KNOWN_BANK, 1))
    smoothed = SmoothedFilters(known, single)
    hypotheses = ReturningObject(rig, filters, smoothed)
    link = SmootherLink(smoothing, rig, Handover(rig, filters, smoothed, hypotheses))
    return BankObserver(filters, rig, seed, hypotheses, link)
