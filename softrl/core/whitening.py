"""Whitening: features that go together are told apart, so that a small difference of large ones counts as much as they do."""

from dataclasses import dataclass

import numpy as np

LEAST = 1e-8  # of the largest variance of scaled features; what varies less is round-off


@dataclass(frozen=True)
class Whitener:
    """``whiten(x) = (x - mean) @ turn``, of unit variance in every direction that varies; fit it on training data only.

    Attributes
    ----------
    mean : (features,)
    turn : (features, directions)
    """

    mean: np.ndarray
    turn: np.ndarray

    @classmethod
    def fit(cls, values: np.ndarray) -> "Whitener":
        """Return the whitener of ``values`` (rows, features), in which some feature varies."""
        mean, spread = values.mean(axis=0), values.std(axis=0)
        spread = np.where(spread > 1e-12 * (1.0 + np.abs(mean)), spread, 1.0)
        scaled = (values - mean) / spread
        variance, direction = np.linalg.eigh(scaled.T @ scaled / len(scaled))
        kept = variance > LEAST * variance.max()
        return cls(mean, direction[:, kept] / np.sqrt(variance[kept]) / spread[:, None])

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Return the whitened rows (rows, directions)."""
        return (values - self.mean) @ self.turn
