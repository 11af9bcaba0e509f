"""Asks PyPI, through pip-audit, whether a locked version has a known hole: `audit.py LOCKFILE…`.

pip-audit alone is content when PyPI answers nothing: it calls each package skipped, and the audit passed.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

SERVICE = "pypi.org"
UNREACHED = re.compile(r"requests\.exceptions\.|Could not connect|ServiceError|ConnectionError")


def audited(lock: Path) -> tuple[bool, list[str]]:
    """Whether nothing speaks against what is locked, and what there is to say."""
    words = ["--disable-pip", "--require-hashes", "--progress-spinner=off", "--format=json", "-r", str(lock)]
    done = subprocess.run([sys.executable, "-m", "pip_audit", *words], capture_output=True, text=True, check=False)
    return judged(done.stdout, done.stderr)


def judged(said: str, complaint: str) -> tuple[bool, list[str]]:
    """The same from pip-audit's report, if there is one, and its complaint. No answer is no failure. Pure."""
    if not said:
        if UNREACHED.search(complaint):
            return True, [f"not audited: no answer from {SERVICE}"]
        return False, [f"not audited: {complaint.strip().rpartition(chr(10))[2] or 'pip-audit failed'}"]
    packages = json.loads(said)["dependencies"]
    unknown = [each["name"] for each in packages if "skip_reason" in each]
    if unknown and len(unknown) == len(packages):
        return True, [f"not audited: no answer from {SERVICE} about any of {len(packages)} packages"]
    holes = [
        f"{each['name']} {each['version']}: {hole['id']}, mended in {', '.join(hole['fix_versions']) or 'no version'}"
        for each in packages
        if "skip_reason" not in each
        for hole in each["vulns"]
    ]
    gone = [f"{name}: its locked version is not on {SERVICE} (any more)" for name in unknown]
    return not holes and not gone, holes + gone or ["no known holes"]


def main(locks: list[str]) -> int:
    good = True
    for lock in locks:
        passed, lines = audited(Path(lock))
        good = good and passed
        print("".join(f"{lock}: {line}\n" for line in lines), end="")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
