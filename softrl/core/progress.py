"""One progress bar a long step: a bar on a terminal, a line a minute in a file, nothing in tests."""

import logging
import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from tqdm import tqdm

log = logging.getLogger(__name__)
T = TypeVar("T")
LINE_EVERY_S = 60.0


def progress(items: Iterable[T], title: str, total: int | None = None) -> Iterator[T]:
    """Yield ``items`` and show how far the loop is, with an estimate of the time left."""
    if total is None and hasattr(items, "__len__"):
        total = len(items)  # type: ignore[arg-type]
    if sys.stderr.isatty():
        yield from tqdm(items, desc=title, total=total, leave=False, dynamic_ncols=True)
        return
    start = last = time.monotonic()
    for done, item in enumerate(items):
        now = time.monotonic()
        if now - last > LINE_EVERY_S and done:
            last = now
            left = f", about {(total - done) * (now - start) / done:.0f} s left" if total else ""
            log.info("%s: %d of %s%s", title, done, total or "?", left)
        yield item


class TqdmHandler(logging.Handler):
    """Writes log lines to the standard error without tearing a progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        tqdm.write(self.format(record), file=sys.stderr)
