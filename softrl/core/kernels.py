"""Where compiled kernels are kept: a folder for each state of the code.

Numba compiles a kernel anew when its own file changes, but not when a kernel that it calls from another file does: after
an update the old machine code would answer. Here any change of a file with kernels, or of one whose constants are compiled
into them, leaves all caches behind.
"""

import contextlib
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

PREFIX = "kernels-"
FORGET_AFTER_S = 14 * 86400.0  # since the last import that used them
KERNELS = (b"numba", b"core.compiled")  # a file with kernels names one of them
CONSTANT = re.compile(r"\b[A-Z_][A-Z0-9_]*\b")


def keep_by_code(package: Path) -> None:
    """Let Numba keep the kernels of ``package`` in a folder named after their sources; unused ones of others are removed."""
    try:
        base = _base()
        folder = base / f"{PREFIX}{mark_of(package)}"
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except (OSError, RuntimeError):  # no home, or none to write in: a place of this process alone
        base = Path(tempfile.mkdtemp(prefix="softrl-"))
        folder = base / f"{PREFIX}{mark_of(package)}"
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    _forget(base)


def _base() -> Path:
    """Return the folder of all caches: the user's choice, or one in the home."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softrl"
    return base.parent if base.name.startswith(PREFIX) else base  # chosen by a process that started this one


def _forget(base: Path) -> None:
    """Remove the caches that were not used for long."""
    for folder in base.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # another process was first
            if time.time() - folder.stat().st_mtime > FORGET_AFTER_S:
                shutil.rmtree(folder)


def mark_of(package: Path) -> str:
    """Return a hash over the files of ``package`` that machine code is made of, and their names."""
    digest = hashlib.sha256()
    for path, source in sorted(compiled_sources(package).items()):
        digest.update(path.encode() + source)
    return digest.hexdigest()[:16]


def compiled_sources(package: Path) -> dict[str, bytes]:
    """Return by their paths in ``package`` the files that hold kernels, and those whose constants they are compiled with."""
    sources = {path.relative_to(package).as_posix(): path.read_bytes() for path in package.rglob("*.py")}
    waiting = [path for path, source in sources.items() if any(word in source for word in KERNELS)]
    found: dict[str, bytes] = {}
    while waiting:
        path = waiting.pop()
        if path in sources and path not in found:
            found[path] = sources[path]
            waiting += _constants_from(package.name, sources[path])
    return found


def _constants_from(package: str, source: bytes) -> list[str]:
    """Return the paths of the modules of ``package`` from which ``source`` imports names in capitals."""
    imports = re.findall(rf"^from {package}\.([\w.]+) import (\([^)]*\)|.*)$", source.decode(), re.MULTILINE)
    return [f"{module.replace('.', '/')}.py" for module, names in imports if CONSTANT.search(names)]
