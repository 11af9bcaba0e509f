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
        one.get("/")  # earlier connections have been accepted by then, and close in good order
