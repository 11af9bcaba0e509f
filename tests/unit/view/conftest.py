"""A daemon's sockets, and the page's server for them."""

import contextlib

import pytest
from served import Daemon, Served


@pytest.fixture
def daemon():
    with contextlib.closing(Daemon()) as one:
        yield one


@pytest.fixture
def served(daemon):
    with contextlib.closing(Served(daemon)) as one:
        yield one
        one.get("/")  # whoever has knocked before has been let in by then, and is let go in good order
