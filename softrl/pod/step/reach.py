"""A word where a body leaves the samples of its reduced model."""

import logging

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel

log = logging.getLogger(__name__)

FARTHER = 1.2  # a body that leaves the samples is reported again when it goes this much farther: fits replay thousands
_reported: dict[tuple[int, str], float] = {}


def warn_beyond(model: ReducedModel, farthest: float, what: str = "motion") -> None:
    """Warn if ``farthest``, the largest ``|y|``, lies where ``model`` has no samples.

    What was said of the ``what`` of a model is said again of one that goes much farther. A model is known by its energy: one
    that is loaded twice is the same.
    """
    if not farthest > 1.0:
        return
    key = hash(model.energy.tobytes()), what
    if farthest > FARTHER * _reported.get(key, 0.0):
        _reported[key] = farthest
        log.warning(
            "reduced model of %s: the body went to %.2f times the reach of its snapshots; beyond 1 its energy is "
            "extrapolated and rises like a wall, so trust the %s less",
            model.robot_name,
            farthest,
            what,
        )


def reach(y: np.ndarray) -> float:
    """Return the largest ``|y|`` of coordinates (S, r)."""
    return float(np.linalg.norm(y, axis=1).max(initial=0.0))
