"""Compiled kernels that a wheel for one platform brings along: put into the cache where there is no compiler.

Where a compiler is installed nothing is done: what it makes is for this very processor. A processor that lacks what the
kernels were compiled for gets none, and runs on CasADi's virtual machine.
"""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from pathlib import Path

from palmd import __version__
from palmd.console.shipped import shipped

INDEX = "index.json"


def take_shipped_kernels() -> None:
    """Fills the cache once for each version; says nothing where that cannot be, for loading says it."""
    folder = shipped("kernels")
    if not folder.is_dir():
        return
    from palmd.model import compiled, compiler

    cache = compiled.cache_directory()
    done = cache / f"shipped-{__version__}"
    with suppress(compiler.CompilerError, OSError, ValueError, KeyError):
        words = compiler.command()
        if (words and shutil.which(words[0])) or done.exists():
            return
        index = json.loads((folder / INDEX).read_bytes())
        if not set(index["needs"]) <= set(compiled._processor().split()):
            return
        cache.mkdir(parents=True, exist_ok=True)
        package = Path(compiled.__file__).parent
        for library in index["libraries"]:
            written = b"".join((package / each).read_bytes() for each in library["written"])
            key = compiled.key_of(compiled._sources() + written)
            note = json.loads((folder / library["note"]).read_bytes())
            shutil.copyfile(folder / note["library"], cache / note["library"])
            (cache / f"{library['name']}-{key}.json").write_text(json.dumps(note), encoding="utf-8")
        done.touch()
