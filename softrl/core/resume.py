"""Results of finished parts of a long piece of work, kept in files until the whole of it is done."""

import contextlib
import logging
import os
import shutil
import sys
import typing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

if sys.platform != "win32":
    import fcntl

log = logging.getLogger(__name__)
HOME = Path(".softrl")  # under the working directory; whatever is in it may be deleted at any time
ATTEMPTS = 100  # to use a folder while others come and go
# folders that this process uses, open under a shared lock, which ends with the process
_used: dict[Path, int | None] = {}


class Kept:
    """A folder of parts, named by all that determines them: an identical run after a kill finds them again.

    Processes that do the same work at the same time share it, as points of a sweep may; the last to end removes it.

    Parameters
    ----------
    work : what is done, e.g. ``fem``
    mark : hash of everything that can change a result (``core.fingerprint``)
    """

    def __init__(self, work: str, mark: str, home: Path = HOME) -> None:
        self.folder = home / work / mark

    def use(self) -> None:
        """Make the folder, and let no other process remove it before this one clears it or ends."""
        place = self.folder.absolute()
        for attempt in range(ATTEMPTS):
            try:
                place.mkdir(parents=True, exist_ok=True)
                if place not in _used:
                    _used[place] = _share(place)
                return
            except (FileNotFoundError, FileExistsError):
                # another process removed it meanwhile, or a parent
                if attempt == ATTEMPTS - 1:
                    raise

    def __contains__(self, name: str) -> bool:
        if not self.folder.is_dir():
            return False
        self.use()
        return (self.folder / f"{name}.npz").is_file()

    def save(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Keep ``arrays`` under ``name``; they appear whole or not at all."""
        self.use()
        part = self.folder / f"{name}.{os.getpid()}.part"
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        part.rename(self.folder / f"{name}.npz")

    def load(self, name: str) -> dict[str, np.ndarray]:
        """Return what was saved under ``name``."""
        with np.load(self.folder / f"{name}.npz", allow_pickle=False) as data:
            return dict(data)

    def clear(self) -> None:
        """Remove all parts, for the work is done; while another process uses them they stay, and it removes them."""
        if self.folder.is_dir():
            self.use()
            opened = _used.pop(self.folder.absolute())
            if _alone(opened):
                shutil.rmtree(self.folder, ignore_errors=True)
            if opened is not None:
                os.close(opened)
        for parent in (self.folder.parent, self.folder.parent.parent):
            with contextlib.suppress(OSError):  # it is not empty, or another process removed it
                parent.rmdir()


def _share(folder: Path) -> int | None:
    """Return ``folder`` open under a shared lock; FileNotFoundError if it was removed before. None where there are no locks."""
    if sys.platform == "win32":
        return None
    opened = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(opened, fcntl.LOCK_SH)
        if not os.path.samestat(os.fstat(opened), folder.stat()):
            raise FileNotFoundError(folder)
    except BaseException:
        os.close(opened)
        raise
    return opened


def _alone(opened: int | None) -> bool:
    """Return whether no other process uses the folder that ``_share`` opened; true where there are no locks to tell."""
    if sys.platform == "win32" or opened is None:
        return True
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return not isinstance(error, BlockingIOError)
    return True


def pack(record: NamedTuple, prefix: str = "") -> dict[str, np.ndarray]:
    """Return the fields of a flat NamedTuple of numbers, tuples of numbers and arrays as arrays."""
    return {prefix + name: np.asarray(value) for name, value in record._asdict().items()}


def unpack(kind: Any, arrays: dict[str, np.ndarray], prefix: str = "") -> Any:
    """Return the NamedTuple of class ``kind`` that ``pack`` took apart."""
    hints = typing.get_type_hints(kind)
    return kind(**{name: _as(hints[name], arrays[prefix + name]) for name in kind._fields})


def _as(hint: Any, array: np.ndarray) -> Any:
    if hint is np.ndarray:
        return array
    return tuple(array.tolist()) if typing.get_origin(hint) is tuple else array.item()
