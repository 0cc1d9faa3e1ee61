"""Standard scaling whose two arrays travel in the artifact of the model that they serve."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Scaler:
    """``scale(x) = (x - mean) / spread`` per last-axis feature; fit it on training data only."""

    mean: np.ndarray
    spread: np.ndarray

    @classmethod
    def fit(cls, values: np.ndarray) -> "Scaler":
        """Return the scaler of ``values`` (..., features); a constant feature keeps spread 1."""
        flat = values.reshape(-1, values.shape[-1])
        spread = flat.std(axis=0)
        return cls(flat.mean(axis=0), np.where(spread > 1e-12 * (1.0 + np.abs(flat.mean(axis=0))), spread, 1.0))

    def scale(self, values: np.ndarray) -> np.ndarray:
        """Return scaled values."""
        return (values - self.mean) / self.spread

    def unscale(self, values: np.ndarray) -> np.ndarray:
        """Return the values that ``scale`` maps to ``values``."""
        return values * self.spread + self.mean
