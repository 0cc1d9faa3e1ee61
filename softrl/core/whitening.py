"""Whitening: features that go together are told apart, so that a small difference of large ones counts as much as they do."""

from dataclasses import dataclass

import numpy as np

from softrl.core.scaling import Scaler

LEAST = 1e-8  # of the largest variance of scaled features; what varies less is round-off


@dataclass(frozen=True)
class Whitener:
    """``whiten(x) = (x - mean) @ turn``; fit it on training data only.

    Attributes
    ----------
    mean : (features,)
    turn : (features, directions)
    """

    mean: np.ndarray
    turn: np.ndarray

    @classmethod
    def fit(cls, values: np.ndarray) -> "Whitener":
        """Return that of ``values`` (rows, features), some varying: unit variance in every direction in which they do."""
        plain = cls.scaling(values)
        mean, spread, scaled = plain.mean, 1.0 / np.diag(plain.turn), plain.whiten(values)
        variance, direction = np.linalg.eigh(scaled.T @ scaled / len(scaled))
        kept = variance > LEAST * variance.max()
        return cls(mean, direction[:, kept] / np.sqrt(variance[kept]) / spread[:, None])

    @classmethod
    def scaling(cls, values: np.ndarray) -> "Whitener":
        """Return that which scales each feature by itself; one that is still keeps its size."""
        scaler = Scaler.fit(values)
        return cls(scaler.mean, np.diag(1.0 / scaler.spread))

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """Return the whitened rows (rows, directions)."""
        return (values - self.mean) @ self.turn
