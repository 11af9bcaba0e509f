"""The installed dependencies agree with the lock files exactly: pinned and hashed, and no others.

Whether a locked version has a known vulnerability is not tested, since that needs the network
(docs/operate/security.md); the
evaluation of the answer is tested.
"""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import runpy
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LOCKS = ("requirements.lock", "requirements-dev.lock")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TYPES_ONLY = {"_typeshed"}
UNLOCKED = {"pydrake": "drake", "rerun": "rerun-sdk"}  # optional packages, by the names they are imported by


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def named(requirement: str) -> str:
    return canonical(re.match(r"[\w.-]+", requirement)[0])  # type: ignore[index]


def entries(lock: str) -> list[str]:
    """The requirements of a lock file, each with its continuation lines, comments left out."""
    text = re.sub(r"^\s*#.*\n", "", (ROOT / lock).read_text(), flags=re.MULTILINE)
    return text.replace("\\\n", " ").splitlines()


def pins(lock: str) -> dict[str, set[str]]:
    """The versions of each package; there may be several, for different Pythons."""
    found: dict[str, set[str]] = {}
    for entry in entries(lock):
        found.setdefault(named(entry), set()).add(entry.split()[0].split("==")[1])
    return found


@pytest.mark.parametrize("lock", LOCKS)
def test_every_requirement_is_pinned_and_hashed(lock: str) -> None:
    assert len(entries(lock)) > 10
    for entry in entries(lock):
        assert re.match(r"[\w.-]+==[\w.+!-]+ ", entry), f"{lock}: {entry[:60]} is not pinned"
        hashes = re.findall(r"--hash=(\S+)", entry)
        assert hashes, f"{lock}: {entry[:60]} has no hash"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", each) for each in hashes), f"{lock}: {entry[:60]}"


def test_both_lock_files_contain_the_declared_dependencies_and_agree() -> None:
    run, dev = map(pins, LOCKS)
    extras = PROJECT["optional-dependencies"]
    demo = [*PROJECT["dependencies"], *extras["build"], *extras["report"]]  # `palmd report` works after `make demo`
    assert {named(each) for each in demo} <= run.keys()
    assert {named(each) for each in extras["dev"]} <= dev.keys()
    assert {name: dev.get(name) for name in run} == run


def test_every_imported_package_is_locked() -> None:
    locked, owners = pins("requirements.lock"), importlib.metadata.packages_distributions()
    optional = {named(each) for extra in PROJECT["optional-dependencies"].values() for each in extra}
    for path in (ROOT / "src").rglob("*.py"):
        for top in sorted(imported(path) - sys.stdlib_module_names - TYPES_ONLY - {"palmd"}):
            packages = {canonical(each) for each in owners.get(top, [UNLOCKED.get(top, top)])}
            assert packages & (locked.keys() | optional), f"{path} imports {top}, which is in no lock file"


def imported(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text())))
    whole = {name.name for node in nodes if isinstance(node, ast.Import) for name in node.names}
    parts = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom) and not node.level}
    return {name.split(".")[0] for name in whole | parts}


def test_installed_versions_are_the_locked_ones_and_compatible() -> None:
    locked = pins("requirements-dev.lock")
    installed = {canonical(each.name): each.version for each in importlib.metadata.distributions()}
    other = {name: version for name, version in installed.items() if version not in locked.get(name, {version})}
    assert not other, "installed in other versions than locked: run `make dev`"
    done = subprocess.run([sys.executable, "-m", "pip", "check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


judged = runpy.run_path(str(ROOT / "tools/audit.py"))["judged"]
CLEAN = {"name": "lz4", "version": "4.4.5", "vulns": []}
HOLE = {"id": "PYSEC-1", "fix_versions": ["7.0"], "aliases": [], "description": "bad"}
HOLED = {"name": "pyyaml", "version": "6.0.3", "vulns": [HOLE]}
SKIPPED = {"name": "casadi", "skip_reason": "Dependency not found on PyPI and could not be audited"}


NOBODY = (True, ["not audited: no answer from pypi.org"])


@pytest.mark.parametrize(
    ("packages", "stderr", "expected"),
    [
        ((CLEAN,), "", (True, ["no known vulnerabilities"])),
        ((CLEAN, HOLED), "", (False, ["pyyaml 6.0.3: PYSEC-1, fixed in 7.0"])),
        ((SKIPPED, SKIPPED), "", NOBODY),
        (None, "…\nrequests.exceptions.ConnectionError: no\n", NOBODY),
        ((CLEAN, SKIPPED), "", (False, ["casadi: its locked version is not on pypi.org (any more)"])),
        (None, "ERROR: requirement x==1 does not contain a hash",
         (False, ["not audited: ERROR: requirement x==1 does not contain a hash"])),
    ],
)  # fmt: skip
def test_an_audit_fails_for_a_vulnerability_or_an_invalid_answer_only(packages, stderr, expected) -> None:
    passed, lines = judged("" if packages is None else json.dumps({"dependencies": packages, "fixes": []}), stderr)
    assert passed == expected[0]
    assert len(lines) == len(expected[1])
    assert all(line.startswith(start) for line, start in zip(lines, expected[1], strict=True))
