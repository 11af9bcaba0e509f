"""A folder without access rights, whoever runs the tests."""

import os
from contextlib import contextmanager

NOBODY = 65534


@contextmanager
def shut(folder):
    """Removes all rights of `folder`, and the process's capability to ignore them."""
    may_all = os.geteuid() == 0
    folder.chmod(0)
    if may_all:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if may_all:
            os.seteuid(0)
        folder.chmod(0o755)
