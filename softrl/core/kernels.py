"""Where compiled kernels are kept: a folder for each state of the code.

Numba compiles a kernel anew when its own file changes, but not when a kernel that it calls from another file does: after
an update the old machine code would answer. Here any change of a file with kernels leaves all caches behind.
"""

import hashlib
import os
import shutil
import sys
import time
from pathlib import Path

PREFIX = "kernels-"
FORGET_AFTER_S = 14 * 86400.0  # since the last import that used them


def keep_by_code(package: Path) -> None:
    """Let Numba keep the kernels of ``package`` in a folder named after their sources; unused ones of others are removed."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softrl"
    if base.name.startswith(PREFIX):  # chosen by a process that started this one
        base = base.parent
    folder = base / f"{PREFIX}{mark_of(package)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for other in base.glob(f"{PREFIX}*"):
            if time.time() - other.stat().st_mtime > FORGET_AFTER_S:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:  # no place to write: Numba looks for one itself
        return
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def mark_of(package: Path) -> str:
    """Return a hash over the files of ``package`` that hold kernels, and their names."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"numba" in source:
            digest.update(str(path.relative_to(package)).encode() + source)
    return digest.hexdigest()[:16]
