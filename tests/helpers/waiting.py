"""Waiting with a time-out and a message."""

import time

PATIENCE_S = 20.0  # time-out for a slow machine; tests do not pass sooner because of it


def wait(look, what, pause_s=0.02, patience_s=PATIENCE_S):
    """The first true result of `look`; after the time-out an error with `what`, which is called if it can be."""
    deadline = time.monotonic() + patience_s
    while not (found := look()):
        if time.monotonic() > deadline:
            raise AssertionError(f"time-out waiting for {what() if callable(what) else what}")
        time.sleep(pause_s)
    return found
