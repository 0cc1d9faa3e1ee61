"""Cores, and the threads of linear algebra: two on two cores that are not idle wait for each other, and spin while they do."""

import os
import sys
from contextlib import AbstractContextManager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Return what holds the threads of the libraries that ``modules`` brought along; it takes milliseconds to find them."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra has one thread."""
    return _libraries(len(sys.modules)).limit(limits=1, user_api="blas")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))
