"""A separate systemd: process 1 of its own namespaces, on a temporary copy of this machine's files.

The files are an overlay whose upper layer is in memory, so that nothing is left afterwards. Run as a program (`boot.py
PROGRAM FOLDER SHARED…`), this module is the first process inside, which becomes PROGRAM.
"""

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SYSTEMD = Path("/lib/systemd/systemd")
TOOLS = ("unshare", "nsenter", "mount", "pivot_root", "ip", "systemctl", "systemd-analyze", "journalctl")
UNSHARE = ["unshare", "--pid", "--fork", "--kill-child", "--mount", "--cgroup", "--uts", "--ipc", "--net"]
NODES = ("null", "zero", "full", "random", "urandom", "tty")
TARGET = "boot.target"
BOOT_S = 30.0

_C = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1
_CLONE_NEWNET = 0x40000000


def obstacle():
    """Why no systemd can be booted here, None if it can."""
    if sys.platform != "linux" or not SYSTEMD.exists():
        return "there is no systemd"
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"there is no {', '.join(missing)}"
    if os.geteuid() != 0:
        return "it takes root"
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "console").touch()
        tried = subprocess.run(_inside("/bin/true", folder), capture_output=True, text=True)
    if tried.returncode != 0:
        return f"namespaces or their mounts are not permitted: {tried.stderr.partition(os.linesep)[0]}"
    return None


def _inside(program, folder, shared=()):
    return [*UNSHARE, sys.executable, __file__, program, str(folder), *map(str, shared)]


class Machine:
    """The booted system."""

    def __init__(self, folder, shared):
        """`shared` are paths that are visible inside, read-only, even if they are separate mounts."""
        self._console = folder / "console"
        self._console.touch()
        with self._console.open("ab") as console:
            self._outside = subprocess.Popen(
                _inside(str(SYSTEMD), folder, shared),
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
                start_new_session=True,
                preexec_fn=lambda: _C.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL),
            )
        try:
            wait(self._is_up, lambda: f"systemd\n{self.console()[-2000:]}", BOOT_S)
        except BaseException:
            self.close()
            raise

    def _is_up(self):
        assert self._outside.poll() is None, f"systemd ended: {self.console()[-2000:]}"
        return self.pid is not None and self.run("systemctl", "is-active", TARGET, check=False).strip() == "active"

    @property
    def pid(self):
        """Process 1 of the inside in our numbering, None while there is none."""
        children = Path(f"/proc/{self._outside.pid}/task/{self._outside.pid}/children").read_text().split()
        return int(children[0]) if children else None

    def console(self):
        """The output of the boot."""
        return self._console.read_text(errors="replace")

    def path(self, inside):
        """The outside path of a path inside."""
        return Path(f"/proc/{self.pid}/root") / inside.lstrip("/")

    def run(self, *words, check=True):
        """Runs a command inside; returns both outputs."""
        done = subprocess.run(
            ["nsenter", "-t", str(self.pid), "-a", "-r", "-w", *map(str, words)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert done.returncode == 0 or not check, f"{' '.join(map(str, words))}: {done.stdout}"
        return done.stdout

    @contextlib.contextmanager
    def network(self):
        """Sockets and threads created within this context belong to the inside."""
        ours_at, theirs_at = (Path(f"/proc/{process}/ns/net") for process in ("self", self.pid))
        with ours_at.open() as ours, theirs_at.open() as theirs:
            _enter(theirs)
            try:
                yield
            finally:
                _enter(ours)

    def close(self):
        """Kills all its processes; its files vanish."""
        self._outside.kill()
        self._outside.wait()


def wait(condition, what, seconds, pause_s=0.05):
    """The first true value of `condition`; fails with `what` after the time-out."""
    t_end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < t_end, f"not within {seconds:g} s: {what()}"
        time.sleep(pause_s)
    return value


def _enter(namespace):
    if _C.setns(namespace.fileno(), _CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), "setns")


# ------------------------------------------------------------------------------------------------------ inside


def _become(program, folder, shared):
    root = _overlay(folder)
    _mount("proc", root / "proc", "-t", "proc")
    _mount("sysfs", root / "sys", "-t", "sysfs", "-o", "ro")
    _mount("cgroup2", root / "sys/fs/cgroup", "-t", "cgroup2")
    _mount("tmpfs", root / "run", "-t", "tmpfs", "-o", "mode=755")
    _devices(root / "dev", folder / "console")
    for path in shared:
        inside = root / path.relative_to("/")
        inside.mkdir(parents=True, exist_ok=True)
        _mount(path, inside, "--bind")
        _mount("none", inside, "-o", "remount,bind,ro")
    _units(root / "etc/systemd/system")
    _tmp_stays(root / "etc")
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    _change_root(root)
    environment = {"container": "test", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}
    os.execve(program, [program, f"--unit={TARGET}", "--log-target=console", "--show-status=1"], environment)


def _overlay(folder):
    """This machine's files with a memory layer above them."""
    layers = folder / "layers"
    layers.mkdir()
    _mount("none", "/", "--make-rprivate")
    _mount("tmpfs", layers, "-t", "tmpfs")
    upper, work, root = (layers / name for name in ("upper", "work", "root"))
    for path in (upper, work, root):
        path.mkdir()
    _mount("overlay", root, "-t", "overlay", "-o", f"lowerdir=/,upperdir={upper},workdir={work}")
    return root


def _change_root(root):
    """Changes the root by pivoting: services need user namespaces, which chroot forbids."""
    os.chdir(root)
    subprocess.run(["pivot_root", ".", "mnt"], check=True)
    os.chroot(".")
    subprocess.run(["umount", "--lazy", "/mnt"], check=True)


def _devices(dev, console):
    _mount("tmpfs", dev, "-t", "tmpfs", "-o", "mode=755")
    for name in NODES:
        (dev / name).touch()
        _mount(f"/dev/{name}", dev / name, "--bind")
    (dev / "console").touch()
    _mount(console, dev / "console", "--bind")
    (dev / "shm").mkdir()
    _mount("tmpfs", dev / "shm", "-t", "tmpfs", "-o", "mode=1777")
    (dev / "pts").mkdir()
    _mount("devpts", dev / "pts", "-t", "devpts", "-o", "newinstance,ptmxmode=0666,mode=620")
    (dev / "ptmx").symlink_to("pts/ptmx")
    (dev / "fd").symlink_to("/proc/self/fd")


def _units(folder):
    """Units: a journal and the tests' own, none of this machine's services."""
    _mount("tmpfs", folder, "-t", "tmpfs", "-o", "mode=755")
    (folder / "systemd-udevd.service").symlink_to("/dev/null")
    (folder / TARGET).write_text("[Unit]\nRequires=systemd-journald.service\nAfter=systemd-journald.service\n")


def _tmp_stays(etc):
    """Keeps /tmp, which a boot would empty or cover, because the tested palmd may be there."""
    (etc / "tmpfiles.d").mkdir(exist_ok=True)
    for name in ("tmpfiles.d/tmp.conf", "systemd/system/tmp.mount"):
        (etc / name).unlink(missing_ok=True)
        (etc / name).symlink_to("/dev/null")


def _mount(what, where, *options):
    subprocess.run(["mount", *options, str(what), str(where)], check=True)


if __name__ == "__main__":
    _become(sys.argv[1], Path(sys.argv[2]), [Path(path) for path in sys.argv[3:]])
