"""Mutation testing of modules that must not fail, with a sample of cosmic-ray's mutants: how many do the tests kill?

    python tools/mutants.py                            all of them: an hour and more
    python tools/mutants.py --sample 60 --seed 1       60 of each module
    python tools/mutants.py --only keys.py --list      list the mutants

Prints the score of each module with its 95 % interval, and every survivor; the sample's seed repeats it. Exit status 1
if fewer than 90 % were killed.

Mutants exist in memory only: for each a process that has loaded everything independent of the module is forked, and
runs the tests that execute the changed line, the fastest first, until one fails. Changes without effect at run time
(annotations, options of a dataclass) are left out.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import math
import os
import random
import resource
import secrets
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

import grimp
import hypothesis
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parent.parent
GOAL = 0.90
CPU_S, WALL_S = 60, 180.0
"""Limits after which a mutant hangs and counts as killed: processor time and wall time (s)."""

SURVIVED, KILLED = 0, 1
_OTHERS = ("numpy", "msgpack", "zmq", "yaml", "pydantic", "serial")

MODULES: dict[str, tuple[str, ...]] = {
    "daemon/lifecycle.py": ("unit/daemon/test_lifecycle.py",),
    "motion/limits.py": (
        "unit/motion/test_limits.py",
        "unit/motion/test_stops.py",
        "unit/motion/test_plan.py",
        "unit/motion/test_usage.py",
        "unit/daemon/test_setpoints.py",
        "property/test_setpoints_property.py",
    ),
    "daemon/setpoints.py": ("unit/daemon/test_setpoints.py", "property/test_setpoints_property.py"),
    "devices/armlink.py": ("unit/devices/test_armlink.py", "property/test_devices_property.py"),
    "devices/armhost.py": ("unit/devices/test_armhost.py", "property/test_devices_property.py"),
    "faults.py": ("unit/test_faults.py",),
    "daemon/supervisor.py": ("unit/daemon/test_core.py", "unit/daemon/test_exploring.py"),
    "keys.py": ("unit/test_keys.py",),
}
"""The modules and the tests that must detect their mutants, without exhaustive and simulated ones."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A module's `text` with one mutation in its `lines`, by an operator of cosmic-ray."""

    operator: str
    text: str
    lines: tuple[int, ...]

    def diff(self, sound: str) -> str:
        """The change as lines before and after."""
        before, after = sound.splitlines(), self.text.splitlines()
        changed = [line for line in difflib.unified_diff(before, after, n=0, lineterm="") if line[:3] not in _HEADS]
        return f"  line {self.lines[0]}, {self.operator.removeprefix('core/')}\n    " + "\n    ".join(changed[1:])


_HEADS = ("---", "+++")


@dataclass(frozen=True, slots=True)
class CleanRun:
    """A module's tests without a mutation: duration of each (s), tests by executed line, loaded modules."""

    durations_s: dict[str, float]
    lines: dict[int, list[str]]
    loaded: list[str]

    def relevant(self, lines: Sequence[int], sound: ast.Module) -> list[str]:
        """The tests that may detect a change of these lines, the fastest first.

        For lines executed while the module is loaded: tests that execute uses of their names, then all others.
        """
        found = {test for line in (*lines, *_used(sound, lines)) for test in self.lines.get(line, ())}
        others = () if any(line in self.lines for line in lines) else set(self.durations_s) - found
        return [test for some in (found, others) for test in sorted(some, key=lambda each: self.durations_s[each])]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, metavar="N", help="a random sample of each module's mutants")
    parser.add_argument("--seed", type=int, help="seed of the sample; default: a random one, printed")
    parser.add_argument("--only", nargs="+", choices=MODULES, default=list(MODULES), metavar="MODULE")
    parser.add_argument("--lines", nargs="+", type=int, metavar="N", help="only mutants of these lines")
    parser.add_argument("--list", action="store_true", help="list the mutants without trying them")
    arguments = parser.parse_args()
    seed = secrets.randbelow(1 << 31) if arguments.seed is None else arguments.seed
    print(f"seed {seed}", flush=True)
    os.chdir(ROOT)
    for name in _OTHERS:
        importlib.import_module(name)
    hypothesis.settings.register_profile(
        "mutants", database=None, phases=[hypothesis.Phase.explicit, hypothesis.Phase.generate], deadline=None
    )
    hypothesis.settings.load_profile("mutants")
    killed, tried, weighed, whole = 0, 0, 0.0, 0
    for module in arguments.only:
        sound = (ROOT / "src/palmd" / module).read_text("utf-8")
        places = _places(sound)
        chosen = _drawn(sound, places, arguments.sample, random.Random(f"{seed} {module}"))
        if arguments.lines is not None:
            chosen = [mutant for mutant in chosen if mutant.lines[0] in arguments.lines]
        if arguments.list:
            print(f"{module}: {len(places)} places", *(mutant.diff(sound) for mutant in chosen), sep="\n")
            continue
        before = time.monotonic()
        died = len(chosen) - _survivors(module, chosen)
        took_s = time.monotonic() - before
        print(f"{module}: {_scored(died, len(chosen))}; {len(places)} places, {took_s:.0f} s", flush=True)
        killed, tried, whole = killed + died, tried + len(chosen), whole + len(places)
        weighed += len(places) * died / max(len(chosen), 1)
    if arguments.list:
        return 0
    print(f"together: {_scored(killed, tried)}; weighted by the modules' places {weighed / max(whole, 1):.1%}")
    return 0 if weighed >= GOAL * whole else 1


def _scored(killed: int, tried: int) -> str:
    """The share with Wilson's 95 % interval."""
    if not tried:
        return "none tried"
    z, p = 1.96, killed / tried
    middle, width = p + z * z / (2 * tried), z * math.sqrt(p * (1 - p) / tried + z * z / (4 * tried * tried))
    low, high = ((middle + way * width) / (1 + z * z / tried) for way in (-1, 1))
    return f"{killed} of {tried} killed, {p:.0%} ({low:.0%} to {high:.0%})"


# ------------------------------------------------------------------------------------------------------ the mutants


_ALIKE = (
    {"Add", "Sub", "Mul", "Div"},
    {"FloorDiv", "Mod", "Mul"},
    {"LShift", "RShift"},
    {"BitAnd", "BitOr", "BitXor"},
    {"Eq", "NotEq", "Lt", "LtE", "Gt", "GtE"},
    {"Is", "IsNot"},
    {"In", "NotIn"},
)
"""Operators that are exchanged; any other exchange, such as a shift of floats, is detected by every test."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place where an operator of cosmic-ray can mutate."""

    operator: str
    occurrence: int
    lines: tuple[int, ...]


def _places(sound: str) -> list[Place]:
    """Every place for a mutation, except options of dataclasses."""
    tree = get_ast(sound)
    nodes = list(ast_nodes(tree))
    options = {
        line
        for node in ast.walk(ast.parse(sound))
        if isinstance(node, ast.ClassDef)
        for decorator in node.decorator_list
        if isinstance(decorator, ast.Call)
        for line in range(decorator.lineno, (decorator.end_lineno or decorator.lineno) + 1)
    }
    found = []
    for name in sorted(operator_names()):
        kind, names = get_operator(name), set(name.rpartition("Operator_")[2].split("_"))
        if kind.arguments() or ("Replace" in name and len(names) == 2 and not any(names <= each for each in _ALIKE)):
            continue
        spans = (span for node in nodes for span in kind().mutation_positions(node))
        for occurrence, (begin, end) in enumerate(spans):
            if begin[0] not in options:
                found.append(Place(name, occurrence, tuple(range(begin[0], end[0] + 1))))
    return found


def _drawn(sound: str, places: Sequence[Place], most: int | None, draw: random.Random) -> list[Mutant]:
    """At most so many distinct mutants with an effect at run time; all by default."""
    runs, found = _what_runs(sound), dict[str, Mutant]()
    for place in draw.sample(places, len(places)):
        if most is not None and len(found) == most:
            break
        text = mutate_code(sound, get_operator(place.operator)(), place.occurrence)
        try:
            if text is not None and _what_runs(text) != runs:
                found.setdefault(text, Mutant(place.operator, text, place.lines))
        except SyntaxError:
            continue
    return sorted(found.values(), key=lambda mutant: (mutant.lines, mutant.operator))


def _what_runs(text: str) -> str:
    return ast.dump(_Unannotated().visit(ast.parse(text)))


class _Unannotated(ast.NodeTransformer):
    """Removes annotations, which are never evaluated."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)


def _used(sound: ast.Module, lines: Sequence[int]) -> Iterator[int]:
    """Lines that use the names assigned in these lines at module or class level."""
    names: set[str] = set()
    for body in (sound.body, *(node.body for node in ast.walk(sound) if isinstance(node, ast.ClassDef))):
        for each in body:
            if each.lineno <= lines[0] <= (each.end_lineno or 0):
                targets = each.targets if isinstance(each, ast.Assign) else [getattr(each, "target", None)]
                names |= {target.id for target in targets if isinstance(target, ast.Name)}
    for node in ast.walk(sound):
        if getattr(node, "id", getattr(node, "attr", None)) in names and isinstance(node, ast.expr):
            yield node.lineno


# --------------------------------------------------------------------------------------------------- running them


def _survivors(module: str, mutants: Sequence[Mutant]) -> int:
    """The number of survivors; each is printed."""
    with tempfile.TemporaryDirectory() as folder:
        count = Path(folder) / "survivors"
        if _forked(lambda: count.write_text(str(_tried(module, mutants))) * 0) or not count.exists():
            raise SystemExit(f"{module}: trying its mutants failed")
        return int(count.read_text())


def _tried(module: str, mutants: Sequence[Mutant]) -> int:
    """The number of survivors; to be called in a separate process, which loads many modules."""
    path = ROOT / "src/palmd" / module
    name = "palmd." + module.removesuffix(".py").replace("/", ".")
    sound = path.read_text("utf-8")
    files = [str(ROOT / "tests" / each) for each in MODULES[module]]
    with tempfile.NamedTemporaryFile("r", suffix=".json") as output:
        status = _forked(lambda: _run_clean(path, files, Path(output.name)))
        if status:
            raise SystemExit(f"{module}: its tests fail without any mutation: {' '.join(files)}")
        noted = json.load(output)
    clean = CleanRun(
        noted["durations_s"], {int(line): tests for line, tests in noted["lines"].items()}, noted["loaded"]
    )
    dependent = {name, *grimp.build_graph("palmd").find_downstream_modules(name)}
    for each in clean.loaded:
        if each not in dependent:
            importlib.import_module(each)
    tree, survivors = ast.parse(sound), 0
    for mutant in mutants:
        tests = clean.relevant(mutant.lines, tree)
        if _forked(lambda mutant=mutant, tests=tests: _run_mutant(mutant, name, path, files, tests)) == SURVIVED:
            survivors += 1
            print(mutant.diff(sound), flush=True)
    return survivors


def _forked(work: Callable[[], int]) -> int:
    """The result of `work` in a forked process; `KILLED` if that dies or hangs."""
    pid = os.fork()
    if pid == 0:
        code = KILLED
        try:
            code = work()
        except SystemExit as error:
            print(error, file=sys.stderr)
        except Exception:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else KILLED


def _run_clean(path: Path, files: Sequence[str], output: Path) -> int:
    """Run the tests without a mutation, and write durations, executed lines and loaded modules to `output`."""
    watch = _Watch(str(path))
    status = _run_tests(files, watch)
    loaded = [name for name in sys.modules if name.split(".")[0] == "palmd"]
    lines = {line: sorted(tests) for line, tests in watch.lines.items()}
    output.write_text(
        json.dumps({"durations_s": watch.durations_s, "lines": lines, "loaded": loaded}), encoding="utf-8"
    )
    return status


def _run_mutant(mutant: Mutant, name: str, path: Path, files: Sequence[str], tests: Sequence[str]) -> int:
    """Run tests on a mutant; returns `KILLED` if one fails."""
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    threading.Thread(target=_end_in, args=(WALL_S,), daemon=True).start()
    sys.meta_path.insert(0, _Finder(name, path, mutant.text))
    wanted = {test.partition("::")[0] for test in tests}
    some = [file for file in _spread(files) if str(Path(file).relative_to(ROOT)) in wanted]
    return SURVIVED if _run_tests(some, _Only(tests)) == 0 else KILLED


def _spread(files: Sequence[str]) -> Iterator[str]:
    for each in files:
        yield from sorted(map(str, Path(each).glob("test_*.py"))) if Path(each).is_dir() else [each]


def _end_in(seconds: float) -> None:
    time.sleep(seconds)
    os.kill(os.getpid(), signal.SIGKILL)


def _run_tests(files: Sequence[str], plugin: object) -> int:
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    how = [
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:timeout",
        "-p",
        "no:xdist",
        "-o",
        "timeout=0",
        "-W",
        "ignore",
    ]
    return int(pytest.main([*how, "--tb=no", "-o", "addopts=", "-m", "not bench", *files], plugins=[plugin]))


class _Finder(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Loads the module with its mutation."""

    def __init__(self, name: str, path: Path, text: str) -> None:
        importlib.machinery.SourceFileLoader.__init__(self, name, str(path))
        self._text = text

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> Any:  # noqa: ARG002
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, _name: str) -> CodeType:
        code: CodeType = compile(self._text, self.path, "exec")
        return code


class _Only:
    """Selects these tests, in this order."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._order = {test: number for number, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((item for item in items if item.nodeid in self._order), key=lambda i: self._order[i.nodeid])


class _Watch:
    """Records the lines of a file that each test executes, and the test's duration."""

    def __init__(self, path: str) -> None:
        self.lines: dict[int, set[str]] = {}
        self.durations_s: dict[str, float] = {}
        self._path, self._test = path, ""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._test, t_cpu = item.nodeid, time.process_time()
        sys.settrace(self._trace)
        threading.settrace(self._trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
            self.durations_s[item.nodeid] = time.process_time() - t_cpu

    def _trace(self, frame: FrameType, event: str, _: Any) -> Any:
        if frame.f_code.co_filename != self._path:
            return None
        if event in ("call", "line"):
            self.lines.setdefault(frame.f_lineno, set()).add(self._test)
        return self._trace


if __name__ == "__main__":
    sys.exit(main())
