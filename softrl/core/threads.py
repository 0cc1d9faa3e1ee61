"""The threads of linear algebra: two on two cores that are not idle wait for each other, and spin while they do."""

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """Return what holds the threads of libraries; it takes milliseconds to find them."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which linear algebra has one thread."""
    return _libraries().limit(limits=1, user_api="blas")
