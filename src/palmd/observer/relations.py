"""Hypotheses on how the vibrations of both palms are related, where that is unknown, weighted by evidence. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

import numpy as np

from palmd.events import FloatArray
from palmd.model.smoothing import R
from palmd.observer.reconstruction import Reconstruction
from palmd.system.description import RigDescription
from palmd.system.vibration import Relation

UNLIKELY_NATS = 7.0  # below the most likely hypothesis, at which one is left out


def with_each_relation(rig: RigDescription) -> list[RigDescription]:
    """The rig itself or, where the relation of its palms' vibrations is unknown, one rig for each relation."""
    vibration = rig.vibration
    if vibration.relation != "unknown" or vibration.averaged:
        return [rig]
    relations: tuple[Relation, ...] = get_args(Relation)
    known = [relation for relation in relations if relation not in ("unknown", "none")]
    return [replace(rig, vibration=replace(vibration, relation=relation)) for relation in known]


def mixture(answers: Sequence[Reconstruction], rigs: Sequence[RigDescription]) -> Reconstruction | None:
    """The most likely of the results for `rigs`, with the spread of the others added to its bands.

    Mean and 1σ of each value are those of the mixture of Gaussians, weighted by evidence; κ is one of the rig's
    constants. The outline is that of the most likely result. None where that is not accepted.
    """
    with_evidence = [(each, rig) for each, rig in zip(answers, rigs, strict=True) if math.isfinite(each.evidence)]
    if not with_evidence:
        return None
    best = max(with_evidence, key=lambda each: each[0].evidence)[0]
    if not best.converged:
        return None
    likely = [(a, rig) for a, rig in with_evidence if a.converged and a.evidence > best.evidence - UNLIKELY_NATS]
    weights = np.exp([a.evidence - best.evidence for a, _ in likely])
    weights /= weights.sum()

    def spread(name: str) -> tuple[FloatArray, FloatArray]:
        values = np.array([getattr(a, name) for a, _ in likely])
        sds = np.array([getattr(a, f"{name}_sd") for a, _ in likely])
        middle = np.asarray(getattr(best, name)) if name == "h" else np.tensordot(weights, values, 1)
        return middle, np.sqrt(np.tensordot(weights, sds**2 + (values - middle) ** 2, 1))

    mixed = {name: spread(name) for name in ("h", "rho", "mu", "mass")}
    kappas = np.array([rig.vibration.kappa for _, rig in likely])
    rig, covariance = best.rig.copy(), best.rig_covariance.copy()
    rig[R.KAPPA] = kappa = float(weights @ kappas)
    covariance[R.KAPPA, R.KAPPA] += float(weights @ (kappas - kappa) ** 2)
    (rho, rho_sd), (mu, mu_sd), (mass, mass_sd) = (map(float, mixed[name]) for name in ("rho", "mu", "mass"))
    return replace(
        best, h_sd=mixed["h"][1], rig=rig, rig_covariance=covariance,
        rho=rho, rho_sd=rho_sd, mu=mu, mu_sd=mu_sd, mass=mass, mass_sd=mass_sd,
    )  # fmt: skip
