"""Series whose neighbouring samples depend on each other."""

import numpy as np
from scipy.signal import lfilter


def coloured(rng: np.random.Generator, count: int, memory: float) -> np.ndarray:
    """Return noise (count,) of first order whose neighbours correlate by ``memory``."""
    noise = rng.standard_normal(count + 500)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise)[500:])
