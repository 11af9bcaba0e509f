"""Notifications to the service manager."""

import os
import socket

import pytest

from palmd.daemon.systemd import Notifier


@pytest.fixture
def manager(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(1.0)
        yield manager


def test_start_up_status_and_end(manager):
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname()})
    notifier.ready()
    notifier.status("ready")
    notifier.status("ready")
    notifier.stopping()
    notifier.close()
    heard = [manager.recv(1000) for _ in range(3)]
    assert heard == [b"READY=1", b"STATUS=ready", b"STOPPING=1"]


def test_the_watchdog_is_notified_four_times_per_timeout(manager):
    environment = {"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "200000", "WATCHDOG_PID": str(os.getpid())}
    notifier = Notifier(environment)
    for i in range(19):
        notifier.healthy(10.0 + i * 0.01)
    notifier.close()
    manager.setblocking(False)
    feeds = 0
    while True:
        try:
            assert manager.recv(100) == b"WATCHDOG=1"
        except BlockingIOError:
            break
        feeds += 1
    assert feeds == 4


@pytest.mark.parametrize(
    "environment", [{}, {"NOTIFY_SOCKET": "/no/such/socket"}, {"NOTIFY_SOCKET": "nonsense", "WATCHDOG_USEC": "soon"}]
)
def test_without_a_service_manager_nothing_is_sent(environment):
    notifier = Notifier(environment)
    notifier.ready()
    notifier.status("x")
    notifier.healthy(1.0)
    notifier.stopping()
    notifier.close()


def test_a_watchdog_for_another_process_is_ignored(manager):
    notifier = Notifier({"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"})
    notifier.healthy(1.0)
    notifier.healthy(9.0)
    notifier.close()
    manager.setblocking(False)
    with pytest.raises(BlockingIOError):
        manager.recv(100)
