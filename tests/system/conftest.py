"""One booted systemd for all tests; palmd's services are stopped before each."""

import pytest
from boot import obstacle
from services import Services


@pytest.fixture(scope="session")
def booted(tmp_path_factory):
    why_not = obstacle()
    if why_not is not None:
        pytest.skip(f"no systemd can be booted: {why_not}")
    services = Services(tmp_path_factory.mktemp("machine"))
    yield services
    services.close()


@pytest.fixture
def services(booted):
    booted.all_stopped()
    return booted
