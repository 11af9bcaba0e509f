"""CasADi functions as compiled C, bound to fixed arrays and called without copies.

The C of a set of functions is generated, compiled once into a cache keyed by the hash of the C, the compiler
and its flags, and checked on load against CasADi's own virtual machine on random inputs. Without a compiler
the virtual machine serves: slower, same numbers.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np

from palmd.events import FloatArray

Backend = Literal["c", "vm"]
FLAGS = ("-O2", "-fPIC", "-shared", "-fno-math-errno", "-ffp-contract=off")
CHECK_INPUTS = 3
CHECK_TOLERANCE = 1e-9

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Library:
    """A set of functions ready to be bound, and what runs them: compiled C or CasADi's virtual machine."""

    functions: dict[str, ca.Function]
    backend: Backend

    def bind(self, name: str, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> BoundCall:
        """A call without arguments that reads `inputs` and writes `outputs` in place, in microseconds.

        Arrays are C-contiguous float64 of exactly the function's sizes, column-major as CasADi stores
        matrices; no output may share memory with an input. Raises ValueError otherwise. The returned call is
        safe inside the loop.
        """
        function = self.functions[name]
        if (len(inputs), len(outputs)) != (function.n_in(), function.n_out()):
            raise ValueError(
                f"{name} takes {function.n_in()} inputs and {function.n_out()} outputs, "
                f"got {len(inputs)} and {len(outputs)}"
            )
        for i, array in enumerate(inputs):
            _check_array(f"{name} input {function.name_in(i)}", array, function.numel_in(i))
        for i, array in enumerate(outputs):
            _check_array(f"{name} output {function.name_out(i)}", array, function.numel_out(i))
            if any(np.shares_memory(array, other) for other in inputs):
                raise ValueError(f"{name} output {function.name_out(i)} shares memory with an input")
        buffer, trigger = function.buffer()
        for i, array in enumerate(inputs):
            buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # the stub knows of no default
        for i, array in enumerate(outputs):
            buffer.set_res(i, array.data)  # type: ignore[call-arg]
        return BoundCall(trigger, (buffer, *inputs, *outputs))


@dataclass(frozen=True, slots=True)
class BoundCall:
    """One function tied to its arrays; holds on to all the memory that the generated code will touch."""

    trigger: Callable[[], None]
    owned: tuple[object, ...]

    def __call__(self) -> None:
        """Evaluate in place."""
        self.trigger()


def _check_array(what: str, array: FloatArray, size: int) -> None:
    if array.dtype != np.float64 or not array.flags.c_contiguous or array.size != size:
        raise ValueError(f"{what}: needs {size} contiguous float64, got {array.size} {array.dtype}")


def densified(function: ca.Function) -> ca.Function:
    """The same function with dense inputs and outputs, so that plain arrays can hold them; shared terms once."""
    inputs = [ca.SX.sym(function.name_in(i), *function.size_in(i)) for i in range(function.n_in())]
    outputs = ca.cse([ca.densify(out) for out in function.call(inputs)])
    return ca.Function(function.name(), inputs, outputs, function.name_in(), function.name_out())


BLOCK = 8
"""Filters that one call of a `NAME_block` kernel serves."""


def mapped_over_block(function: ca.Function) -> ca.Function:
    """`NAME_block`: the densified function applied to `BLOCK` filters side by side, all with the same last input."""
    return function.map(f"{function.name()}_block", "serial", BLOCK, [function.n_in() - 1], [])


def load(name: str, functions: Sequence[ca.Function], cache: Path | None = None) -> Library:
    """Generate, compile (or find in the cache), verify and load `functions` as one library called `name`.

    Takes seconds the first time and milliseconds afterwards; not for use inside the loop. Never raises for
    want of a compiler or of a writable cache: it falls back to the virtual machine with a warning.
    """
    by_name = {function.name(): function for function in functions}
    compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:
        log.warning("no C compiler: observers run on CasADi's virtual machine (install gcc for speed)")
        return Library(by_name, "vm")
    try:
        library = _compile(name, functions, compiler, cache or cache_directory())
    except (OSError, subprocess.CalledProcessError) as error:
        detail = error.stderr.strip() if isinstance(error, subprocess.CalledProcessError) else error
        log.warning("could not compile %s, using CasADi's virtual machine: %s", name, detail)
        return Library(by_name, "vm")
    compiled = {key: ca.external(key, str(library)) for key in by_name}
    for key, function in by_name.items():
        _check_against_vm(compiled[key], function)
    return Library(compiled, "c")


def cache_directory() -> Path:
    """Where compiled observers live: $CACHE_DIRECTORY (systemd), else the user's cache."""
    if service := os.environ.get("CACHE_DIRECTORY"):
        return Path(service)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "palmd"


def _compile(name: str, functions: Sequence[ca.Function], compiler: str, cache: Path) -> Path:
    cache.mkdir(parents=True, exist_ok=True)
    version = subprocess.run([compiler, "--version"], check=True, capture_output=True, text=True).stdout
    with tempfile.TemporaryDirectory(dir=cache) as folder:
        generator = ca.CodeGenerator(f"{name}.c", {"with_header": False})
        for function in functions:
            generator.add(function)
        source = Path(generator.generate(f"{folder}/"))
        key = hashlib.sha256()
        for part in (
            source.read_bytes(),
            version.encode(),
            " ".join(FLAGS).encode(),
            platform.machine().encode(),
        ):
            key.update(part + b"\0")
        target = cache / f"{name}-{key.hexdigest()[:24]}.so"
        if not target.exists():
            built = Path(folder) / "built.so"
            command = [compiler, *FLAGS, "-o", str(built), str(source), "-lm"]
            subprocess.run(command, check=True, capture_output=True, text=True)
            ctypes.CDLL(str(built))  # refuse a library that cannot be loaded before anybody relies on it
            built.replace(target)
    return target


def _check_against_vm(compiled: ca.Function, function: ca.Function) -> None:
    """Raise RuntimeError when the compiled code and the virtual machine disagree on random inputs."""
    random = np.random.default_rng(0)
    for _ in range(CHECK_INPUTS):
        arguments = [random.uniform(0.2, 0.9, function.size_in(i)) for i in range(function.n_in())]
        for index, (got, wanted) in enumerate(zip(compiled.call(arguments), function.call(arguments), strict=True)):
            a, b = np.asarray(got), np.asarray(wanted)
            if not np.allclose(a, b, rtol=CHECK_TOLERANCE, atol=CHECK_TOLERANCE, equal_nan=True):
                worst = float(np.nanmax(np.abs(a - b)))
                raise RuntimeError(
                    f"compiled {function.name()} differs from CasADi's virtual machine in output "
                    f"{function.name_out(index)} by {worst:.3g}; delete the cache {cache_directory()} and retry"
                )
