"""Compiled kernels, bound to fixed arrays and called without copies.

Kernels are generated, compiled and checked once (`model.building`) into a cache. What is found there is loaded in a
millisecond, without CasADi: its name tells the sources, the compiler's flags and the processor that it was made from
and for, a note beside it its functions and its hash. Where nothing can be compiled, libraries that the wheel of a
release carries are loaded. Without these, C by hand is refused (decision 32); what is generated alone runs on CasADi's
virtual machine: slower, the same numbers to rounding.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import json
import logging
import os
import platform
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from palmd.console.errors import RIG_FAILED, CliError
from palmd.events import FloatArray
from palmd.model import compiler

if TYPE_CHECKING:
    from palmd.model.kernels import Kernel

Backend = Literal["c", "vm"]
LANES = 8
"""Columns that stand side by side in a kernel of columns, which serves any multiple of so many."""

NEEDS = "needs.txt"
"""Beside libraries that a wheel carries: the features of a processor, by NumPy's names, that they need."""

FAILED = ".failed"
"""Ends the name of a file that says why a library could not be compiled, beside where it would be."""

EXPORTED = "kernel_"  # before a kernel's name: what a library exports
# no contraction: the same bits on every processor
FLAGS = ("-fPIC", "-shared", "-fno-math-errno", "-ffp-contract=off", "-Wno-psabi")
NATIVE = "-march=native"
"""For this processor, unless CC names another: `CC="cc -march=x86-64-v3"`."""

WRITTEN, GENERATED = ("-O2",), ("-O1", "-fexpensive-optimizations", "-ftree-slp-vectorize")
"""How far C by hand and generated C are optimised: straight lines gain nothing by the slower half of -O2.

Only with `-fexpensive-optimizations` does GCC clear the vector registers' upper halves before libm, which is slow else.
"""

log = logging.getLogger(__name__)
_SAID: set[str] = set()

Run = Callable[[int], None]


class NotCompiledError(CliError):
    """What has C by hand could not be compiled, and no wheel carries it; the text says why, and what to do."""

    def __init__(self, name: str, why: str) -> None:
        self.why = why
        super().__init__(RIG_FAILED, f"{name} cannot be compiled, and runs compiled only: {why}")


@dataclass(frozen=True, slots=True)
class Signature:
    """A kernel's inputs and outputs: name and size of each, of one column where it is of columns.

    All columns have the `shared` inputs in common.
    """

    inputs: tuple[tuple[str, int], ...]
    outputs: tuple[tuple[str, int], ...]
    columns: bool
    shared: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Library:
    """A set of kernels ready to be bound, and what runs them: compiled C or CasADi's virtual machine.

    `path` is that of the compiled library, which there is wherever C by hand is part of it.
    """

    signatures: dict[str, Signature]
    backend: Backend
    runner: Callable[[str, Sequence[FloatArray], Sequence[FloatArray]], Run]
    path: Path | None = None

    def opened(self) -> ctypes.CDLL:
        """The compiled library itself; raises RuntimeError where its kernels run on CasADi's virtual machine."""
        if self.path is None:
            raise RuntimeError("kernels are not compiled; see `palmd doctor`")
        return ctypes.CDLL(str(self.path))

    def bind(self, name: str, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> BoundCall:
        """A call that reads `inputs` and writes `outputs` in place, in microseconds.

        Arrays are C-contiguous float64 of exactly the kernel's sizes, matrices column-major as CasADi stores them; of a
        kernel of columns one column after the other, a multiple of `LANES` of them. No output may share memory with an
        input. Raises ValueError otherwise. The returned call is safe inside the loop.
        """
        told = self.signatures[name]
        if (len(inputs), len(outputs)) != (len(told.inputs), len(told.outputs)):
            raise ValueError(
                f"{name} takes {len(told.inputs)} inputs and {len(told.outputs)} outputs, "
                f"got {len(inputs)} and {len(outputs)}"
            )
        columns = 1
        if told.columns:
            first = next(i for i in range(len(inputs)) if i not in told.shared)
            columns = inputs[first].size // told.inputs[first][1]
            if columns < 1 or columns % LANES:
                raise ValueError(f"{name} takes a multiple of {LANES} columns, got {columns}")
        for i, (array, (called, size)) in enumerate(zip(inputs, told.inputs, strict=True)):
            _check_array(f"{name} input {called}", array, size if i in told.shared else columns * size)
        for array, (called, size) in zip(outputs, told.outputs, strict=True):
            _check_array(f"{name} output {called}", array, columns * size)
            if any(np.shares_memory(array, other) for other in inputs):
                raise ValueError(f"{name} output {called} shares memory with an input")
        return BoundCall(self.runner(name, inputs, outputs), columns, (*inputs, *outputs))


@dataclass(frozen=True, slots=True)
class BoundCall:
    """One kernel tied to its arrays; holds on to all the memory that the generated code will touch."""

    run: Run
    columns: int
    owned: tuple[object, ...]

    def __call__(self, columns: int | None = None) -> None:
        """Evaluate in place; only the first `columns`, a multiple of `LANES`, where that is given."""
        self.run(self.columns if columns is None else columns)


def _check_array(what: str, array: FloatArray, size: int) -> None:
    if array.dtype != np.float64 or not array.flags.c_contiguous or array.size != size:
        raise ValueError(f"{what}: needs {size} contiguous float64, got {array.size} {array.dtype}")


def load_written(name: str, source: Path) -> ctypes.CDLL | None:
    """A file of C alone as a library called `name`; None, with a warning, where it cannot be had and Python serves."""
    try:
        return load(name, list, written=[str(source)]).opened()
    except NotCompiledError as error:
        say(f"{name} runs slower, in Python: {error.why}")
        return None


def load(
    name: str,
    kernels: Callable[[], Iterable[Kernel]],
    folder: Path | None = None,
    written: Sequence[str] = (),
) -> Library:
    """The library called `name` from the cache (or `folder`); what is not there yet is built, from `kernels()`.

    `written`: files of C by hand that are compiled with it, in this package or by their absolute paths. Takes seconds
    the first time and a millisecond afterwards; not for use inside the loop. For want of a compiler or of a writable
    cache it falls back to the virtual machine with a warning, or raises NotCompiledError where there is C by hand.
    """
    files = [_PACKAGE / each for each in written]
    sources = _sources() + b"".join(each.read_bytes() for each in files)
    note = (folder or cache_directory()) / f"{name}-{key_of(sources)}.json"
    found = _opened(note)
    if found is None and not compiler.installed():
        found = shipped_library(name, sources)
    if found is not None:
        return found
    from palmd.model import building

    made, warning, why = list(kernels()), "", "its compiler does not work"
    failed = note.with_suffix(FAILED)
    try:
        if compiler.known_fault(note.parent):
            pass  # whoever found it has said so
        elif failed.exists():
            raise compiler.CompilerError(f"{failed.read_text(encoding='utf-8')} (`palmd doctor build` tries again)")
        elif building.build(name, made, files, note, sources):
            found = _opened(note)
        else:
            why = "no C compiler (install gcc, or a wheel that carries compiled kernels)"
            warning = "no C compiler: observers run on CasADi's virtual machine (install gcc for speed)"
    except (OSError, compiler.CompilerError) as error:
        why = f"{error.filename or note.parent}: {error.strerror}" if isinstance(error, OSError) else str(error)
        warning = f"{name} is not compiled, and runs slower: {why}"
    found = found or shipped_library(name, sources)
    if written and found is None:
        raise NotCompiledError(name, why)
    if warning:
        say(warning)
    return found or building.on_the_vm(made)


def say(text: str) -> None:
    """Warn once for each reason, whichever library it was found with."""
    reason = text.partition(": ")[2] or text
    if reason not in _SAID:
        _SAID.add(reason)
        log.warning("%s", text)


def forget_failures() -> None:
    """Have what could not be compiled tried again."""
    for failed in cache_directory().glob(f"*{FAILED}"):
        failed.unlink(missing_ok=True)


def cache_directory() -> Path:
    """Where compiled observers live: $CACHE_DIRECTORY (systemd), else the user's cache."""
    if service := os.environ.get("CACHE_DIRECTORY"):
        return Path(service)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "palmd"


_PACKAGE = Path(__file__).parent
SHIPPED = _PACKAGE.with_name("data") / "kernels"
"""Where a wheel for one platform carries libraries (`tools/wheel.py`)."""

_SOURCES = (_PACKAGE, _PACKAGE.with_name("system"))


def key_of(source: bytes) -> str:
    """What tells one build of a source from another."""
    told = hashlib.sha256(source)
    for part in (
        os.environ.get("CC", ""),
        " ".join((NATIVE, *FLAGS, *WRITTEN, *GENERATED)),
        platform.machine(),
        _processor(),
    ):
        told.update(part.encode() + b"\0")
    return told.hexdigest()[:24]


def shipped_note(name: str, sources: str) -> str:
    """The name of the note on a library that a wheel carries, made from sources of that hash."""
    return f"{name}-{sources[:24]}.json"


def shipped_library(name: str, sources: bytes) -> Library | None:
    """A library that the wheel carries, if it was made from these sources and this processor can run it."""
    note = SHIPPED / shipped_note(name, hash_of(sources))
    return _opened(note) if note.exists() and shipped_fits() else None


def shipped_fits() -> bool:
    """Whether the wheel carries libraries and this processor has all that they were compiled for."""
    try:
        needed = (SHIPPED / NEEDS).read_text(encoding="utf-8").split()
    except FileNotFoundError:
        return False
    return set(needed) <= set(_processor().split())


def hash_of(sources: bytes) -> str:
    """Of what a library is made from, wherever and for whichever processor."""
    return hashlib.sha256(sources).hexdigest()


@cache
def _sources() -> bytes:
    """The hash of all that kernels are generated from."""
    told = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted(folder.iterdir()):
            if path.suffix in (".py", ".h", ".c"):
                told.update(path.name.encode() + b"\0" + path.read_bytes())
    return told.digest()


@cache
def _processor() -> str:
    """What the processor can do: libraries are made for it. Asked of NumPy, as a service may not see /proc/cpuinfo."""
    found: Mapping[str, bool] = getattr(
        importlib.import_module("numpy._core._multiarray_umath"), "__cpu_features__", {}
    )
    return " ".join(sorted(name for name, has in found.items() if has)) or platform.processor()


def _opened(note: Path) -> Library | None:
    """The library that a note tells of; None when there is none, or it is not what was built."""
    try:
        told = json.loads(note.read_bytes())
        path = note.with_name(told["library"])
        if hashlib.sha256(path.read_bytes()).hexdigest() != told["sha256"]:
            log.warning("%s is not what was built, and is built anew", path)
            path.unlink()
            return None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError) as error:
        log.warning("%s cannot be used, and is built anew: %s", note, error)
        return None
    try:
        compiled = ctypes.CDLL(str(path))
    except OSError:  # what is built instead can be loaded, or says why not
        return None
    signatures = {name: _signature(fields) for name, fields in told["kernels"].items()}

    def runner(name: str, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> Run:
        function = compiled[EXPORTED + name]
        function.argtypes, function.restype = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long), None
        into, out = (_addresses(arrays) for arrays in (inputs, outputs))
        at, to = ctypes.addressof(into), ctypes.addressof(out)

        def run(columns: int, _held: object = (into, out)) -> None:
            function(at, to, columns)

        return run

    return Library(signatures, "c", runner, path)


def _addresses(arrays: Sequence[FloatArray]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))


def _signature(fields: dict[str, Any]) -> Signature:
    inputs, outputs = (tuple((name, size) for name, size in fields[key]) for key in ("inputs", "outputs"))
    return Signature(inputs, outputs, fields["columns"], tuple(fields["shared"]))


def note_of(signatures: dict[str, Signature], library: Path, sources: bytes) -> str:
    """What is written beside a library made from `sources`."""
    kernels = {name: asdict(signature) for name, signature in signatures.items()}
    sha256 = hashlib.sha256(library.read_bytes()).hexdigest()
    note = {"library": library.name, "sha256": sha256, "sources": hash_of(sources), "kernels": kernels}
    return json.dumps(note)
