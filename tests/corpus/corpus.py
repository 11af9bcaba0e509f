"""Frozen behaviour: what `estimate`, `reconstruct` and `replay --check` make of stored logs and recordings.

A case is a file in `logs/`: an event log (`NAME.jsonl.xz`) or a recorded run (`NAME.mcap`). What came out of it when it
was frozen stands in `expected/NAME.json`. Numbers are compared at a relative tolerance of 1e-9; the search for a
hypothesis amplifies the last bit of a floating-point operation, so on a processor whose arithmetic differs (see
`arithmetic`) only verdicts are compared.

    python tests/corpus/corpus.py check [--sample] [NAME...]
    python tests/corpus/corpus.py freeze [NAME...]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import lzma
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
LOGS, EXPECTED = HERE / "logs", HERE / "expected"
TOLERANCE = 1e-9
SAMPLE = (
    "arcs-cradle-0", "arcs-dome-0", "coloured-14", "flat-absent-0", "flat-friction-exact-1", "flat-nominal-exact-0",
    "flat-odd-exact-0", "flat-rests-0", "flat-rig-exact-0", "pivot-float-1", "pivot-tilt-1", "things-dent-of-10-mm",
)  # fmt: skip
"""Each system, and of each kind the case that costs least, except rubbing on curved palms."""
SECONDS_BETWEEN_TICKS_KEPT = 1.0
VALUES_KEPT = 24  # of a long list: evenly spread
NOT_COMPARED = {"seconds", "seq", "timestamp", "mono_ns", "version"}  # clocks and labels
SINGLE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")

Case = dict[str, Any]


def names() -> list[str]:
    """All cases, in alphabetical order."""
    return sorted(path.name.split(".")[0] for path in LOGS.iterdir() if path.suffix in {".xz", ".mcap"})


def observed(name: str) -> Case:
    """What the present code makes of a case; `cost` is its processor time in units of the reference kernel."""
    with tempfile.TemporaryDirectory() as folder:
        source = _unpacked(name, Path(folder))
        before = os.times()
        case: Case = {}
        if source.suffix == ".mcap":
            status, text = _palmd("replay", "--check", str(source))
            case["replay"] = {"status": status, "agrees": _agreement(text)}
        output = Path(folder) / "out"
        _, text = _palmd("estimate", str(source), "-o", str(output), check=True)
        lines = output.read_text().splitlines()
        case["estimate"] = {"digest": _digest(lines), **_ticks(lines)}
        _palmd("reconstruct", str(source), "-o", str(output), check=True)
        result = json.loads(output.read_text())
        case["reconstruct"] = {
            "digest": _digest([json.dumps(_without_clocks(result))]),
            "result": _thinned(_without_clocks(result)),
        }
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        case["processor_s"] = round(spent, 2)
        return case


def compare(expected: Case, found: Case, exact: bool) -> list[str]:
    """Where the two differ, one line each; without `exact` only verdicts count."""
    if not exact:
        verdicts = [
            (case["reconstruct"]["result"].get("verdict"), case["reconstruct"]["result"]["converged"])
            for case in (expected, found)
        ]
        return [] if verdicts[0] == verdicts[1] else [f"verdict: was {verdicts[0]}, is {verdicts[1]}"]
    differences = []
    for part in ("replay", "estimate", "reconstruct"):
        if part in expected and expected[part].get("digest") != found.get(part, {}).get("digest", object()):
            differences += list(_different(expected[part], found.get(part), part))
    if "replay" in expected and not differences:
        differences += list(_different(expected["replay"], found.get("replay"), "replay"))
    return differences


def arithmetic() -> str:
    """A fingerprint of this machine's floating-point arithmetic: equal ones give bit-identical estimates.

    The kernels are compiled for the processor at hand: what the compiler makes use of is in it, too.
    """
    generator = np.random.default_rng(1)
    a = generator.normal(size=(40, 40))
    values = [np.linalg.solve(a @ a.T + np.eye(40), a), np.exp(a), np.sin(a), np.linalg.cholesky(a @ a.T + np.eye(40))]
    found = hashlib.sha256(b"".join(v.tobytes() for v in values))
    if shutil.which("cc"):
        options = subprocess.run(["cc", "-march=native", "-Q", "--help=target"], capture_output=True, check=False)
        found.update(options.stdout)
    return found.hexdigest()[:16]


def reference_kernel_s() -> float:
    """Processor time (s) of a fixed piece of NumPy and Python: the unit in which costs are compared."""
    a = np.random.default_rng(2).normal(size=(60, 60))
    begun = time.process_time()
    total = 0.0
    for k in range(2000):
        total += float((a @ a)[k % 60, 0]) + math.fsum(range(60))
    assert math.isfinite(total)
    return time.process_time() - begun


def _palmd(*arguments: str, check: bool = False) -> tuple[int, str]:
    """Run one command of palmd; RuntimeError with its message when `check` and it fails."""
    command = [sys.executable, "-m", "palmd", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | SINGLE_THREAD, check=False)
    if check and done.returncode:
        raise RuntimeError(f"palmd {' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()[-400:]}")
    return done.returncode, done.stdout + done.stderr


def _unpacked(name: str, folder: Path) -> Path:
    packed = LOGS / f"{name}.jsonl.xz"
    if not packed.exists():
        return LOGS / f"{name}.mcap"
    target = folder / f"{name}.jsonl"
    target.write_bytes(lzma.decompress(packed.read_bytes()))
    return target


def _agreement(text: str) -> str:
    """The sentence's numbers: how many ticks agree of how many, whatever words stand between them."""
    return " ".join(word for word in text.replace(",", "").split() if word.isdigit())


def _ticks(lines: list[str]) -> Case:
    """How many ticks there are and are valid, and the fields of one tick a second."""
    ticks = [tick for line in lines if "valid" in (tick := json.loads(line))]
    kept: list[Any] = []
    due = -math.inf
    for tick in ticks:
        if tick["t"] >= due:
            kept.append(_without_clocks(tick))
            due = tick["t"] + SECONDS_BETWEEN_TICKS_KEPT
    return {"ticks": len(ticks), "valid": sum(bool(tick["valid"]) for tick in ticks), "kept": kept}


def _without_clocks(value: dict[str, Any]) -> dict[str, Any]:
    return {key: each for key, each in value.items() if key not in NOT_COMPARED}


def _thinned(value: Any) -> Any:
    """The same with long lists of numbers thinned, and prose dropped: `reason` may be reworded."""
    if isinstance(value, dict):
        return {key: _thinned(each) for key, each in value.items() if key != "reason"}
    if isinstance(value, list) and len(value) > VALUES_KEPT:
        step = len(value) / VALUES_KEPT
        return [_thinned(value[int(k * step)]) for k in range(VALUES_KEPT)]
    return [_thinned(each) for each in value] if isinstance(value, list) else value


def _digest(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def _different(one: Any, other: Any, place: str) -> Iterator[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() - {"digest"}):
            yield from _different(one[key], other.get(key), f"{place}.{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from _different(a, b, f"{place}[{k}]")
    elif isinstance(one, float) and isinstance(other, (int, float)):
        if not math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=1e-12):
            yield f"{place}: was {one!r}, is {other!r}"
    elif one != other:
        yield f"{place}: was {str(one)[:80]}, is {str(other)[:80]}"


def frozen(name: str) -> Case:
    case: Case = json.loads((EXPECTED / f"{name}.json").read_text())
    return case


def _machine() -> Case:
    case: Case = json.loads((HERE / "machine.json").read_text())
    return case


def _selected(asked: list[str], sample: bool) -> list[str]:
    every = names()
    unknown = set(asked) - set(every)
    if unknown:
        raise SystemExit(f"no case is named {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    return asked or ([*SAMPLE] if sample else every)


def freeze(asked: list[str]) -> None:
    """Store what the present code makes of the cases."""
    EXPECTED.mkdir(exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        selected = _selected(asked, sample=False)
        for name, case in zip(selected, pool.map(_one_by_process, selected), strict=True):
            (EXPECTED / f"{name}.json").write_text(json.dumps(case, indent=0, sort_keys=True) + "\n")
            print(f"{name}: frozen, {case['processor_s']} s")
    machine = {"arithmetic": arithmetic(), "reference_kernel_s": min(reference_kernel_s() for _ in range(5))}
    (HERE / "machine.json").write_text(json.dumps(machine) + "\n")


def check(asked: list[str], sample: bool) -> int:
    """The number of cases that differ from what was frozen; prints each difference."""
    machine = _machine()
    exact = machine["arithmetic"] == arithmetic()
    if not exact:
        print("this processor's arithmetic differs from that of the frozen results: only verdicts are compared")
    unit = min(reference_kernel_s() for _ in range(5)) / machine["reference_kernel_s"]
    failed, was_s, is_s = 0, 0.0, 0.0
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        selected = _selected(asked, sample)
        for name, case in zip(selected, pool.map(_one_by_process, selected), strict=True):
            expected = frozen(name)
            differences = compare(expected, case, exact)
            ratio = case["processor_s"] / max(expected["processor_s"], 1e-9) / unit
            was_s, is_s = was_s + expected["processor_s"], is_s + case["processor_s"] / unit
            print(f"{name}: {'as frozen' if not differences else 'DIFFERS'}, processor time × {ratio:.2f}")
            for line in differences[:8]:
                print(f"    {line}")
            failed += bool(differences)
    print(f"{len(selected)} cases, {failed} differ, processor time in all × {is_s / max(was_s, 1e-9):.2f}")
    return failed


def _one_by_process(name: str) -> Case:
    """A case by a process of its own, so that its children's processor time is its own."""
    done = subprocess.run([sys.executable, __file__, "observe", name], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr.strip()[-600:]}")
    case: Case = json.loads(done.stdout)
    return case


def main() -> int:
    """0 when nothing differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("check", "freeze", "observe"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--sample", action="store_true", help="one case of each kind only")
    arguments = parser.parse_args()
    if arguments.action == "observe":
        print(json.dumps(observed(arguments.names[0])))
        return 0
    if arguments.action == "freeze":
        freeze(arguments.names)
        return 0
    return int(check(arguments.names, arguments.sample) > 0)


if __name__ == "__main__":
    sys.exit(main())
