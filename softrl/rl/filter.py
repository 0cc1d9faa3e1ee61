"""The moving average that smooths what is sent to the robot."""

from collections import deque

import numpy as np

from softrl.core.errors import ConfigError


class MovingAverage:
    """Mean of the last ``window`` values, of fewer while there have been fewer: a constant passes from the start."""

    def __init__(self, window: int) -> None:
        if window < 1:
            raise ConfigError(f"average_window={window} must be at least 1")
        self._last: deque[np.ndarray] = deque(maxlen=window)

    def advance(self, value: np.ndarray) -> np.ndarray:
        """Return the mean (n,) of the last values, ``value`` (n,) included."""
        self._last.append(np.array(value, dtype=float))
        return np.asarray(np.mean(self._last, axis=0))


def moving_average(values: np.ndarray, window: int) -> np.ndarray:
    """Return the moving average (steps, n) of a whole sequence."""
    average = MovingAverage(window)
    return np.stack([average.advance(value) for value in values])
