"""Shape classification of the live outline for the page; done here because the daemon's loop has no time for it."""

from __future__ import annotations

from collections.abc import Mapping

import msgpack
import numpy as np

from palmd.blas import one_thread
from palmd.events import FloatArray
from palmd.observer.shape_classification import root_of_band, shape_class
from palmd.payload import unpacked
from palmd.quantities import ESTIMATE, SHAPE

TOPIC = "view/shape_class"
PERIOD_S = 3.0
"""Period of the classification, which takes about 0.15 s of processor time in its own thread."""


_COLUMNS = ("theta_rad", "h_m", "h_sd_m", "touched")
"""Fields of an outline with a number for each normal."""


class NamingError(Exception):
    """The published shape is not an outline; the text says why."""


def shape_class_message(latest: Mapping[str, bytes]) -> bytes | None:
    """The page's message with the class of the last outline in the `latest` payloads; None without a valid one.

    The outline's covariance is approximated by that of a smooth error with the published standard deviations, as in
    reports. Raises NamingError for an outline in another format, as from user observers.
    """
    estimate, shape = (unpacked(latest.get(topic.name, b"")) or {} for topic in (ESTIMATE, SHAPE))
    if not estimate.get("valid") or not shape:
        return None
    theta, h, sd, touched = _columns(shape)
    if not len(h):
        return None
    with one_thread():
        classified = shape_class(theta, h, root_of_band(sd, theta), touched.astype(bool))
    return bytes(msgpack.packb({"object": estimate.get("object"), "text": classified.text}))


def _columns(shape: Mapping[str, object]) -> FloatArray:
    """Normals, support function, its standard deviation and touched normals, (4, n)."""
    lacking = [name for name in _COLUMNS if not isinstance(shape.get(name), list)]
    if lacking:
        raise NamingError(f"{SHAPE.name} has no list {', '.join(lacking)}")
    try:
        columns: FloatArray = np.array([shape[name] for name in _COLUMNS], dtype=float)
    except (TypeError, ValueError):
        raise NamingError(f"{SHAPE.name}: {', '.join(_COLUMNS)} are not lists of numbers of equal length") from None
    if columns.ndim != 2 or not np.isfinite(columns).all():
        raise NamingError(f"{SHAPE.name}: {', '.join(_COLUMNS)} are not lists of finite numbers of equal length")
    return columns
