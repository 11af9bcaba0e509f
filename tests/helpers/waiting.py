"""Waiting that has an end and says what it waited for."""

import time

PATIENCE_S = 20.0  # how long a slow machine may take; no test passes the sooner for it


def wait(look, what, pause_s=0.02, patience_s=PATIENCE_S):
    """What `look` returns, once it is true; `what` is told otherwise, called first if it can be."""
    deadline = time.monotonic() + patience_s
    while not (found := look()):
        if time.monotonic() > deadline:
            raise AssertionError(f"waited in vain for {what() if callable(what) else what}")
        time.sleep(pause_s)
    return found
