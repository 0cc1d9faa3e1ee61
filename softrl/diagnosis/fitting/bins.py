"""Short times whose means are compared: what is faster is noise, or nothing that a fit could follow."""

from functools import cached_property

import numpy as np

ROUNDED = 1e-4  # of a bin: a row at its very edge belongs to the bin that begins there, however its time is rounded


class Bins:
    """The bins of a run from its sample ``first`` on, without empty ones, and without samples that were not ``seen``.

    Attributes
    ----------
    places : (bins,) which bins out of the run's whole time hold samples
    number : (samples,) of which of these every sample is, those not seen next to it
    """

    def __init__(self, time: np.ndarray, first: int, bin_s: float, seen: np.ndarray):
        self._first = first
        place = ((time[first:] - time[0]) / bin_s + ROUNDED).astype(int)
        self._seen = seen[first:].astype(float)
        self.places = np.unique(place[seen[first:]])
        self.number = np.minimum(np.searchsorted(self.places, place), len(self.places) - 1)

    def __len__(self) -> int:
        return len(self.places)

    @cached_property
    def _samples(self) -> np.ndarray:
        """Number of samples (bins, 1) in every bin."""
        return np.bincount(self.number, self._seen)[:, None]

    @property
    def noise_left(self) -> float:
        """Share of white noise's variance that the means hold."""
        return float(np.mean(1.0 / self._samples))

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Return the means (bins, n) of ``values`` (steps, n) of the whole run."""
        sums = np.stack([np.bincount(self.number, self._seen * column) for column in values[self._first :].T], axis=1)
        return np.asarray(sums / self._samples)
