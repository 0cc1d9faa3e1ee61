"""How small inner functions are compiled.

They only borrow arrays, so they are compiled without reference counts, and into their callers: taking a model's tuple apart, or
passing its hundred words, costs more than the arithmetic of a small body. Such a function cannot allocate. Larger ones may
stand alone.
"""

from typing import Any

import numba as nb

FAST = {"reassoc", "contract"}  # sums in any order: what lets the compiler use vectors

# nothing outside Python calls them by C's convention: without that wrapper they compile in six sevenths of the time
_ALONE: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = _ALONE | {"forceinline": True}
standing: Any = nb.njit(fastmath=FAST, **_ALONE)
borrowing: Any = nb.njit(**_INNER)
summing: Any = nb.njit(fastmath=FAST, **_INNER)


def standing_as(signature: Any) -> Any:
    """Return the decorator of a function that is called by its address: counting its references took longer than most laws."""
    return nb.njit(signature, **_ALONE)
