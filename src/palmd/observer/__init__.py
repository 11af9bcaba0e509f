"""Observers of two palms: events of palms and pads in, estimates of the object out."""

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
    """Import `Simulated` on first use: the daemon runs its smoother in another process."""
    if name != "Simulated":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from palmd.observer.simulated_smoother import Simulated

    return Simulated


EXTENDED_BANK, SHAPE_BANK, KNOWN_BANK = 24, 32, 24  # multiples of model.compiled.BLOCK


def flat_only(name: ObserverName) -> str:
    """Reason why an observer does not support curved palms; empty where it does."""
    return (
        ""
        if name == "shape"
        else f"the observer {name} supports flat palms only; use the observer shape for curved palms"
    )


def make(
    name: ObserverName,
    rig: RigDescription,
    seed: int = 0,
    smoothing: Smoothing | None = None,
    outlines: Sequence[Outline] = (),
) -> Observer:
    """Make the observer `name` for `rig`; takes seconds when its C code has to be compiled first.

    smoothing: where the smoother of a shape map runs; None for no smoother. Other observers have none.
    outlines: for shape maps only: the object is one of these or none of them, and no smoother is needed.
    Raises ValueError for curved palms where the observer supports flat ones only (`flat_only`).
    """
    if rig.curved and (reason := flat_only(name)):
        raise ValueError(reason)
    rig = map_as_noise(rig)
    # local imports: only what the selected observer needs is loaded
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
