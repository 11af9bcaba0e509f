"""What the live outline looks like, for the page: worked out beside it, for a tick of palmd has no time for that."""

from __future__ import annotations

from collections.abc import Mapping

import msgpack
import numpy as np

from palmd.blas import one_thread
from palmd.events import FloatArray
from palmd.observer.shape_classification import root_of_band, shape_class
from palmd.payload import unpacked
from palmd.quantities import ESTIMATE, SHAPE

TOPIC = "view/looks_like"
EVERY_S = 3.0
"""Takes some 0.15 s of a processor each time, on a thread of its own."""


_COLUMNS = ("theta_rad", "h_m", "h_sd_m", "touched")
"""Of an outline, a number for each normal."""


class NamingError(Exception):
    """What is published tells no outline; says why."""


def named(latest: Mapping[str, bytes]) -> bytes | None:
    """The page's message about the last outline in `latest` payloads; None while there is none that is vouched for.

    Its covariance is taken for that of a smooth error as large as its band, as in reports. Raises NamingError for an
    outline of somebody who says it otherwise than palmd does.
    """
    estimate, shape = (unpacked(latest.get(topic.name, b"")) or {} for topic in (ESTIMATE, SHAPE))
    if not estimate.get("valid") or not shape:
        return None
    theta, h, sd, touched = _columns(shape)
    if not len(h):
        return None
    with one_thread():
        told = shape_class(theta, h, root_of_band(sd, theta), touched.astype(bool))
    return bytes(msgpack.packb({"object": estimate.get("object"), "said": told.text}))


def _columns(shape: Mapping[str, object]) -> FloatArray:
    """Normals, support function, its one-sigma and what was touched, (4, n)."""
    lacking = [name for name in _COLUMNS if not isinstance(shape.get(name), list)]
    if lacking:
        raise NamingError(f"{SHAPE.name} has no list {', '.join(lacking)}")
    try:
        columns: FloatArray = np.array([shape[name] for name in _COLUMNS], dtype=float)
    except (TypeError, ValueError):
        raise NamingError(f"{SHAPE.name}: {', '.join(_COLUMNS)} are not equally many numbers") from None
    if columns.ndim != 2 or not np.isfinite(columns).all():
        raise NamingError(f"{SHAPE.name}: {', '.join(_COLUMNS)} are not equally many finite numbers")
    return columns
