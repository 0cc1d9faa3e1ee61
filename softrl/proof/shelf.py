"""Work that is done once: its result is kept as soon as it is there, so that a proof that was stopped goes on."""

import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from softrl.proof.ledger import text_of

log = logging.getLogger(__name__)


def kept(work: Callable[..., Any], job: tuple[Any, ...], place: Path) -> Any:
    """Return ``work(*job)``, read from ``place`` if it was done before, else written there whole or not at all."""
    if not place.is_file():
        made = work(*job)
        place.parent.mkdir(parents=True, exist_ok=True)
        part = place.with_suffix(f".{os.getpid()}.part")
        part.write_text(text_of(made))
        part.replace(place)
    return json.loads(place.read_text())
