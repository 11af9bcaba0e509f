"""Check locked versions for known vulnerabilities with pip-audit and PyPI: `audit.py LOCKFILE…`.

Without an answer from PyPI pip-audit alone reports each package as skipped and succeeds; here that is reported.
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
    """Whether the lock file passes, with lines to print."""
    options = ["--disable-pip", "--require-hashes", "--progress-spinner=off", "--format=json", "-r", str(lock)]
    done = subprocess.run([sys.executable, "-m", "pip_audit", *options], capture_output=True, text=True, check=False)
    return judged(done.stdout, done.stderr)


def judged(report: str, errors: str) -> tuple[bool, list[str]]:
    """The same from pip-audit's report, if there is one, and its error output. No answer is no failure. Pure."""
    if not report:
        if UNREACHED.search(errors):
            return True, [f"not audited: no answer from {SERVICE}"]
        return False, [f"not audited: {errors.strip().rpartition(chr(10))[2] or 'pip-audit failed'}"]
    packages = json.loads(report)["dependencies"]
    unknown = [each["name"] for each in packages if "skip_reason" in each]
    if unknown and len(unknown) == len(packages):
        return True, [f"not audited: no answer from {SERVICE} about any of {len(packages)} packages"]
    vulnerabilities = [
        f"{each['name']} {each['version']}: {found['id']}, fixed in {', '.join(found['fix_versions']) or 'no version'}"
        for each in packages
        if "skip_reason" not in each
        for found in each["vulns"]
    ]
    missing = [f"{name}: its locked version is not on {SERVICE} (any more)" for name in unknown]
    return not vulnerabilities and not missing, vulnerabilities + missing or ["no known vulnerabilities"]


def main(locks: list[str]) -> int:
    good = True
    for lock in locks:
        passed, lines = audited(Path(lock))
        good = good and passed
        print("".join(f"{lock}: {line}\n" for line in lines), end="")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
