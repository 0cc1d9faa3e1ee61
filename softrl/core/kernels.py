"""Where compiled kernels are kept: a folder for each state of the code.

Numba compiles a kernel anew when its own file changes, but not when a kernel that it calls from another file does: after
an update the old machine code would answer. Here any change of a file with kernels leaves all caches behind.
"""

import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

PREFIX = "kernels-"
FORGET_AFTER_S = 14 * 86400.0  # since the last import that used them


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
    """Return a hash over the files of ``package`` that hold kernels, and their names."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"numba" in source:
            digest.update(str(path.relative_to(package)).encode() + source)
    return digest.hexdigest()[:16]
