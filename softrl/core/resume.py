"""Results of finished parts of a long piece of work, kept in files until the whole of it is done."""

import logging
import os
import shutil
import typing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

log = logging.getLogger(__name__)
HOME = Path(".softrl")  # under the working directory; whatever is in it may be deleted at any time


class Kept:
    """A folder of parts, named by all that determines them: an identical run after a kill finds them again.

    Parameters
    ----------
    work : what is done, e.g. ``fem``
    mark : hash of everything that can change a result (``core.fingerprint``)
    """

    def __init__(self, work: str, mark: str, home: Path = HOME) -> None:
        self.folder = home / work / mark

    def __contains__(self, name: str) -> bool:
        return (self.folder / f"{name}.npz").is_file()

    def save(self, name: str, arrays: dict[str, np.ndarray]) -> None:
        """Keep ``arrays`` under ``name``; they appear whole or not at all."""
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self.folder / f"{name}.{os.getpid()}.part"
        with part.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        part.rename(self.folder / f"{name}.npz")

    def load(self, name: str) -> dict[str, np.ndarray]:
        """Return what was saved under ``name``."""
        with np.load(self.folder / f"{name}.npz", allow_pickle=False) as data:
            return dict(data)

    def clear(self) -> None:
        """Remove all parts: the work is done."""
        shutil.rmtree(self.folder, ignore_errors=True)
        for parent in (self.folder.parent, self.folder.parent.parent):
            if parent.is_dir() and not any(parent.iterdir()):
                parent.rmdir()


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
