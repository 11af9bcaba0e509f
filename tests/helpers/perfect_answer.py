"""A simulator's truth and a perfect reconstruction of it, apart from the given changes."""

import math

import numpy as np

from palmd.observer.reconstruction import Reconstruction
from palmd.system.rig_constants import RIG_NAMES

THETA = np.arange(360) * (math.tau / 360)
T = np.arange(301) * 0.01


def support(theta):
    return 0.02 + 1e-3 * np.cos(theta - 0.4) + 8e-4 * np.cos(2 * theta) + 3e-4 * np.sin(3 * theta)


def simulator_truth(**changes):
    lines = {
        "rho_m": 0.014, "mass_kg": 0.1, "mu": 0.2, "dither_m_s": 0.01, "damping_m2_s": 0.0, "theta_rad": THETA.tolist(),
        "h_m": support(THETA).tolist(), "t": T.tolist(), "psi_rad": np.sin(4.0 * T).tolist(),
        "omega0_rad_s": (4.0 * np.cos(4.0 * T)).tolist(), "r1_m": (0.02 + 1e-3 * T).tolist(),
        "r2_m": (0.02 - 1e-3 * T).tolist(), "rig": dict.fromkeys(RIG_NAMES, 0.0),
    }  # fmt: skip
    return lines | changes


def answer(**changes):
    """The gauge is 0.7 rad off; times lie on the nodes of the truth and between them."""
    t = np.arange(0.2, 2.9, 0.007)
    values = {
        "converged": True, "chi2": 1.0, "theta": THETA, "h": support(THETA + 0.7), "h_sd": np.full(360, 1e-5),
        "touched": THETA < 2.0, "rho": 0.014, "rho_sd": 1e-3, "mu": 0.2, "mu_sd": 0.1, "mass": 0.1, "mass_sd": 0.01,
        "t": t, "psi": np.sin(4.0 * t) + 0.7, "omega0": 4.0 * np.cos(4.0 * t), "radii": np.stack([t, t]),
        "seconds": 1.5, "visits": None, "rig": np.zeros(len(RIG_NAMES)), "rig_covariance": np.eye(len(RIG_NAMES)),
        "contradicted": np.zeros(len(RIG_NAMES)), "rig_prior_sd": np.ones(len(RIG_NAMES)),
        "turned_sd": 1e-3,
    }  # fmt: skip
    return Reconstruction(**values | changes)


NO_SHAPE = {"converged": False, "h": None, "h_sd": None, "touched": None, "t": T[:0], "psi": T[:0], "omega0": T[:0]}
