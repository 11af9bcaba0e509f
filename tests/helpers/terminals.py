"""Pseudo-terminals that replace serial lines."""

import os
import tty
from contextlib import contextmanager


@contextmanager
def line():
    """Descriptor of the far end, and the port's path."""
    far, near = os.openpty()
    tty.setraw(near)
    try:
        yield far, os.ttyname(near)
    finally:
        os.close(far)
        os.close(near)
