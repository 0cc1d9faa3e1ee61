"""A word where a body leaves the samples of its reduced model."""

import logging

import numpy as np

log = logging.getLogger(__name__)

FARTHER = 1.2  # a body that leaves the samples is reported again when it goes this much farther: fits replay thousands
_reported: dict[str, float] = {}


def warn_beyond(robot_name: str, farthest: float, what: str = "motion") -> None:
    """Warn if ``farthest``, the largest ``|y|``, lies where the model has no samples, unless it was said of one nearly as far."""
    if farthest > max(1.0, FARTHER * _reported.get(robot_name, 0.0)):
        _reported[robot_name] = farthest
        log.warning(
            "reduced model of %s: the body went to %.2f times the reach of its snapshots; beyond 1 its energy is "
            "extrapolated and rises like a wall, so trust the %s less",
            robot_name,
            farthest,
            what,
        )


def reach(y: np.ndarray) -> float:
    """Return the largest ``|y|`` of coordinates (S, r)."""
    return float(np.linalg.norm(y, axis=1).max(initial=0.0))
