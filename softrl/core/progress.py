"""One progress bar a long step: a bar on a terminal, a line a minute in a file, nothing in tests."""

import logging
import re
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from tqdm import tqdm

log = logging.getLogger(__name__)
T = TypeVar("T")
LINE_EVERY_S = 60.0
MOST_ALIKE = 3  # warnings of one kind on the console


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


@contextmanager
def quiet() -> Iterator[None]:
    """Tell errors only meanwhile: what a trial run warns of is no news."""
    logger = logging.getLogger("softrl")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


class TqdmHandler(logging.Handler):
    """Writes log lines to the standard error without tearing a progress bar; of warnings that are alike the first few."""

    def __init__(self) -> None:
        super().__init__()
        self._alike: Counter[tuple[str, object]] = Counter()

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line, unless it warns of what was told before."""
        line = self.format(record)
        if record.levelno == logging.WARNING:
            kind = record.name, _kind_of(record)
            self._alike[kind] += 1
            if self._alike[kind] > MOST_ALIKE:
                return
            line += " (further warnings of this kind: softrl.log)" if self._alike[kind] == MOST_ALIKE else ""
        tqdm.write(line, file=sys.stderr)


def _kind_of(record: logging.LogRecord) -> object:
    """Return what warnings that are alike have in common: their form, or of sentences without one, what is told of any run."""
    return re.sub(r"^[^:]*: |[\d.]+", "", record.getMessage()) if record.msg == "%s" else record.msg
