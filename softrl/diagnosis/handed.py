"""Jobs as bytes for other processes. What jobs share is one and the same thing there, and what is kept of it is found again."""

import io
import pickle
from functools import lru_cache
from typing import Any

from softrl.core.identity import Same
from softrl.diagnosis.problem import Problem
from softrl.effects.replay import Supply
from softrl.recordings.recording import Recording

SHARED = (Problem, Recording, Supply)  # and a problem's simulator
KEPT = 128  # things that are kept on either side


def packed(job: tuple[Any, ...]) -> bytes:
    """Return ``job`` as bytes; they never leave this machine."""
    return _written(job, None)


@lru_cache(maxsize=KEPT)
def _packed_once(same: Same[Any]) -> bytes:
    return _written(same.thing, same.thing)


def _written(thing: Any, whole: Any) -> bytes:
    into = io.BytesIO()
    _Packer(into, whole).dump(thing)
    return into.getvalue()


class _Packer(pickle.Pickler):
    """Writes what is shared, but for the ``whole`` itself, as bytes of its own, which are read once."""

    def __init__(self, into: io.BytesIO, whole: Any) -> None:
        super().__init__(into, pickle.HIGHEST_PROTOCOL)
        self._whole = whole

    def reducer_override(self, thing: Any) -> Any:
        """Return how to read ``thing``; NotImplemented for the usual way."""
        shared = isinstance(thing, SHARED) or thing is getattr(self._whole, "simulator", None)
        return (unpacked, (_packed_once(Same(thing)),)) if shared and thing is not self._whole else NotImplemented


@lru_cache(maxsize=KEPT)
def unpacked(data: bytes) -> Any:
    """Return what ``packed`` has written, the same thing for the same bytes."""
    return pickle.loads(data)
