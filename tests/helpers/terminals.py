"""Pseudo-terminals that pass for serial lines."""

import os
import tty
from contextlib import contextmanager


@contextmanager
def line():
    """The far end's descriptor, and the port's path."""
    far, near = os.openpty()
    tty.setraw(near)
    try:
        yield far, os.ttyname(near)
    finally:
        os.close(far)
        os.close(near)
