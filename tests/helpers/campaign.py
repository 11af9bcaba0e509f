"""Parameters of a test that run in `make nightly` only."""

import pytest


def nightly(*values):
    """The values, or tuples of values, as parameters marked `nightly`."""
    each = (value if isinstance(value, tuple) else (value,) for value in values)
    return [pytest.param(*value, marks=pytest.mark.nightly) for value in each]
