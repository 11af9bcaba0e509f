"""What the live outline looks like, for the page: worked out beside it, for a tick of palmd has no time for that."""

from __future__ import annotations

from collections.abc import Mapping

import msgpack
import numpy as np

from palmd.blas import one_thread
from palmd.observer.likeness import likeness, root_of_band
from palmd.payload import unpacked
from palmd.quantities import ESTIMATE, SHAPE

TOPIC = "view/looks_like"
EVERY_S = 3.0
"""Takes some 0.15 s of a processor each time, on a thread of its own."""


def named(latest: Mapping[str, bytes]) -> bytes | None:
    """The page's message about the last outline in `latest` payloads; None while there is none that is vouched for.

    Its covariance is taken for that of a smooth error as large as its band, as in reports.
    """
    estimate, shape = (unpacked(latest.get(topic.name, b"")) or {} for topic in (ESTIMATE, SHAPE))
    if not estimate.get("valid") or not shape.get("h_m"):
        return None
    theta, h, sd = (np.array(shape[name]) for name in ("theta_rad", "h_m", "h_sd_m"))
    with one_thread():
        told = likeness(theta, h, root_of_band(sd, theta), np.array(shape["touched"], dtype=bool))
    return bytes(msgpack.packb({"object": estimate["object"], "said": told.said}))
