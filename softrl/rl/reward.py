"""The reward of all tasks."""

import numpy as np

WIDER = 10.0


def weigh(
    alpha: float, position_error: np.ndarray, force_error: np.ndarray, position_scale: float, force_scale: float
) -> np.ndarray:
    """Return R (B,) = alpha R_q + (1 - alpha) R_F in 0 .. 1 (eq. 21) of errors (B,) m and N, none negative.

    Notes
    -----
    ``R_q`` and ``R_F`` are each the mean of ``exp(-error / scale)`` at the given and at a wider scale: steep at zero, so
    that the last tenth of a millimetre pays, yet telling far away where to go. The paper's own shape of the two terms
    was not checked.
    """
    return alpha * _closeness(position_error, position_scale) + (1.0 - alpha) * _closeness(force_error, force_scale)


def _closeness(error: np.ndarray, scale: float) -> np.ndarray:
    return 0.5 * np.exp(-error / scale) + 0.5 * np.exp(-error / (WIDER * scale))
