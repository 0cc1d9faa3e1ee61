"""The reward of all tasks."""

import numpy as np


def weigh(
    alpha: float, position_error: np.ndarray, force_error: np.ndarray, position_scale: float, force_scale: float
) -> np.ndarray:
    """Return R (B,) = alpha R_q + (1 - alpha) R_F in 0 .. 1 (eq. 21) of errors (B,) m and N, none negative.

    Notes
    -----
    ``R_q`` and ``R_F`` are ``exp(-error / scale)``: steep at zero, so that the last tenth of a millimetre pays. The
    paper's own shape of the two terms was not checked.
    """
    return alpha * np.exp(-position_error / position_scale) + (1.0 - alpha) * np.exp(-force_error / force_scale)
