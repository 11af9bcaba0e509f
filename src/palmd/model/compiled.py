"""Load compiled kernels and bind them to fixed arrays, so that calls copy nothing.

Kernels are generated, compiled and checked once (`model.building`) and kept in a cache. Loading from it takes a
millisecond and does not need CasADi: the file name identifies sources, compiler flags and processor; a note (JSON)
beside the library holds its function signatures and its hash. Without a working compiler, libraries shipped in the
release's wheel are loaded. Without these too, libraries with handwritten C raise NotCompiledError (decision 32); purely
generated ones run on CasADi's virtual machine: slower, same results up to rounding.
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
"""Columns that a column kernel processes side by side; it takes any multiple of this number."""

NEEDS = "needs.txt"
"""File beside shipped libraries: the processor features that they need, in NumPy's names."""

FAILED = ".failed"
"""Suffix of the file with the reason why a library could not be compiled, in place of the library."""

EXPORTED = "kernel_"  # prefix of the exported symbols
# no contraction (FMA), so that every processor gives the same bits
FLAGS = ("-fPIC", "-shared", "-fno-math-errno", "-ffp-contract=off", "-Wno-psabi")
NATIVE = "-march=native"
"""Compile for this processor, unless CC names another: `CC="cc -march=x86-64-v3"`."""

WRITTEN, GENERATED = ("-O2",), ("-O1", "-fexpensive-optimizations", "-ftree-slp-vectorize")
"""Optimisation flags of handwritten and of generated C, which is straight-line code and gains nothing from full -O2.

GCC clears the upper halves of the vector registers before libm calls only with `-fexpensive-optimizations`; without it
these calls are slow.
"""

log = logging.getLogger(__name__)
_WARNED: set[str] = set()  # reasons already logged

Run = Callable[[int], None]


class NotCompiledError(CliError):
    """A library with handwritten C could not be compiled and is not shipped; the message says why and what to do."""

    def __init__(self, name: str, why: str) -> None:
        self.why = why
        super().__init__(RIG_FAILED, f"{name} cannot be compiled, and runs compiled only: {why}")


@dataclass(frozen=True, slots=True)
class Signature:
    """Name and size of each input and output of a kernel; for a column kernel, the size of one column.

    `shared`: indices of the inputs that all columns have in common.
    """

    inputs: tuple[tuple[str, int], ...]
    outputs: tuple[tuple[str, int], ...]
    columns: bool
    shared: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Library:
    """A set of kernels ready to be bound, run as compiled C or on CasADi's virtual machine.

    path: of the compiled library, None on the virtual machine. Libraries with handwritten C always have one.
    """

    signatures: dict[str, Signature]
    backend: Backend
    runner: Callable[[str, Sequence[FloatArray], Sequence[FloatArray]], Run]
    path: Path | None = None

    def opened(self) -> ctypes.CDLL:
        """Open the compiled library itself; raises RuntimeError when its kernels run on CasADi's virtual machine."""
        if self.path is None:
            raise RuntimeError("kernels are not compiled; see `palmd doctor`")
        return ctypes.CDLL(str(self.path))

    def bind(self, name: str, inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]) -> BoundCall:
        """Return a call that reads `inputs` and writes `outputs` in place, in microseconds.

        Arrays are C-contiguous float64 of exactly the kernel's sizes, matrices column-major as in CasADi; a column
        kernel takes one column after the other, a multiple of `LANES` of them. No output may share memory with an
        input. Raises ValueError otherwise. The returned call is safe inside the loop.
        """
        signature = self.signatures[name]
        if (len(inputs), len(outputs)) != (len(signature.inputs), len(signature.outputs)):
            raise ValueError(
                f"{name} takes {len(signature.inputs)} inputs and {len(signature.outputs)} outputs, "
                f"got {len(inputs)} and {len(outputs)}"
            )
        columns = 1
        if signature.columns:
            first = next(i for i in range(len(inputs)) if i not in signature.shared)
            columns = inputs[first].size // signature.inputs[first][1]
            if columns < 1 or columns % LANES:
                raise ValueError(f"{name} takes a multiple of {LANES} columns, got {columns}")
        for i, (array, (argument, size)) in enumerate(zip(inputs, signature.inputs, strict=True)):
            _check_array(f"{name} input {argument}", array, size if i in signature.shared else columns * size)
        for array, (argument, size) in zip(outputs, signature.outputs, strict=True):
            _check_array(f"{name} output {argument}", array, columns * size)
            if any(np.shares_memory(array, other) for other in inputs):
                raise ValueError(f"{name} output {argument} shares memory with an input")
        return BoundCall(self.runner(name, inputs, outputs), columns, (*inputs, *outputs))


@dataclass(frozen=True, slots=True)
class BoundCall:
    """A kernel bound to its arrays; keeps all memory alive that the compiled code accesses."""

    run: Run
    columns: int
    owned: tuple[object, ...]

    def __call__(self, columns: int | None = None) -> None:
        """Evaluate in place: all columns, or the first `columns` (a multiple of `LANES`)."""
        self.run(self.columns if columns is None else columns)


def _check_array(what: str, array: FloatArray, size: int) -> None:
    if array.dtype != np.float64 or not array.flags.c_contiguous or array.size != size:
        raise ValueError(f"{what}: needs {size} contiguous float64, got {array.size} {array.dtype}")


def load_written(name: str, source: Path) -> ctypes.CDLL | None:
    """Load a library of handwritten C alone; None, with a warning, if unavailable and the caller falls back to Python.

    `name`: of the library in the cache. `source`: the C file.
    """
    try:
        return load(name, list, written=[str(source)]).opened()
    except NotCompiledError as error:
        warn_once(f"{name} runs slower, in Python: {error.why}")
        return None


def load(
    name: str,
    kernels: Callable[[], Iterable[Kernel]],
    folder: Path | None = None,
    written: Sequence[str] = (),
) -> Library:
    """Load the library `name` from the cache (or `folder`); if it is missing, build it from `kernels()`.

    `written`: handwritten C files compiled into it, relative to this package or absolute. Takes seconds the first time
    and a millisecond afterwards; not for the loop. Without a compiler or a writable cache it falls back to the virtual
    machine with a warning, or raises NotCompiledError if there is handwritten C.
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
            pass  # already reported by the process that found it
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
        warn_once(warning)
    return found or building.on_the_vm(made)


def warn_once(text: str) -> None:
    """Log a warning once per reason (the text after the first colon), whichever library it concerns."""
    reason = text.partition(": ")[2] or text
    if reason not in _WARNED:
        _WARNED.add(reason)
        log.warning("%s", text)


def forget_failures() -> None:
    """Delete the records of failed builds, so that they are tried again."""
    for failed in cache_directory().glob(f"*{FAILED}"):
        failed.unlink(missing_ok=True)


def cache_directory() -> Path:
    """Return the folder of compiled libraries: $CACHE_DIRECTORY (systemd), else the user's cache."""
    if service := os.environ.get("CACHE_DIRECTORY"):
        return Path(service)
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "palmd"


_PACKAGE = Path(__file__).parent
SHIPPED = _PACKAGE.with_name("data") / "kernels"
"""Libraries shipped in a wheel for one platform (`tools/wheel.py`)."""

_SOURCES = (_PACKAGE, _PACKAGE.with_name("system"))


def key_of(source: bytes) -> str:
    """Return a hash that distinguishes builds: source, $CC, compiler flags, processor."""
    digest = hashlib.sha256(source)
    for part in (
        os.environ.get("CC", ""),
        " ".join((NATIVE, *FLAGS, *WRITTEN, *GENERATED)),
        platform.machine(),
        _processor(),
    ):
        digest.update(part.encode() + b"\0")
    return digest.hexdigest()[:24]


def shipped_note(name: str, sources: str) -> str:
    """Return the file name of a shipped library's note; `sources`: hash of the sources it was made from."""
    return f"{name}-{sources[:24]}.json"


def shipped_library(name: str, sources: bytes) -> Library | None:
    """Load the shipped library if it was made from these sources and this processor can run it, else None."""
    note = SHIPPED / shipped_note(name, hash_of(sources))
    return _opened(note) if note.exists() and shipped_fits() else None


def shipped_fits() -> bool:
    """True if the wheel ships libraries and this processor has all features that they need."""
    try:
        needed = (SHIPPED / NEEDS).read_text(encoding="utf-8").split()
    except FileNotFoundError:
        return False
    return set(needed) <= set(_processor().split())


def hash_of(sources: bytes) -> str:
    """Return the hash of a library's sources, independent of compiler and processor."""
    return hashlib.sha256(sources).hexdigest()


@cache
def _sources() -> bytes:
    """Return the hash of all files that kernels are generated from."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted(folder.iterdir()):
            if path.suffix in (".py", ".h", ".c"):
                digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.digest()


@cache
def _processor() -> str:
    """Return the processor's features, from NumPy, since a service may not see /proc/cpuinfo."""
    found: Mapping[str, bool] = getattr(
        importlib.import_module("numpy._core._multiarray_umath"), "__cpu_features__", {}
    )
    return " ".join(sorted(name for name, has in found.items() if has)) or platform.processor()


def _opened(note: Path) -> Library | None:
    """Open the library that a note describes; None if either is missing or the library's hash is not the note's."""
    try:
        fields = json.loads(note.read_bytes())
        path = note.with_name(fields["library"])
        if hashlib.sha256(path.read_bytes()).hexdigest() != fields["sha256"]:
            log.warning("%s differs from what was built (wrong hash): building it again", path)
            path.unlink()
            return None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError) as error:
        log.warning("%s cannot be used, building it again: %s", note, error)
        return None
    try:
        compiled = ctypes.CDLL(str(path))
    except OSError:  # the caller rebuilds it, and reports why if that fails
        return None
    signatures = {name: _signature(kernel) for name, kernel in fields["kernels"].items()}

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
    """Return the note (JSON) of a library made from `sources`."""
    kernels = {name: asdict(signature) for name, signature in signatures.items()}
    sha256 = hashlib.sha256(library.read_bytes()).hexdigest()
    note = {"library": library.name, "sha256": sha256, "sources": hash_of(sources), "kernels": kernels}
    return json.dumps(note)
