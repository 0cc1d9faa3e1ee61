"""How far apart the rows of a log are meant to be, which some stretches of it may write more slowly than others."""

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening, median_filter

SEVERAL = 6  # equal intervals in a row are meant
ALIKE = 0.2  # of their length, by which such may differ
SLOWER = 1.8  # times the usual interval: what is less needs no other period


def periods(apart: np.ndarray) -> np.ndarray:
    """Return the period (intervals,) s of a log around each of the intervals ``apart`` (intervals,) s between its rows.

    That is their median, or where several equal ones in a row are longer, their own: rows that were lost leave intervals of all
    lengths, and a log that is written more slowly for a while does not.
    """
    usual = np.full(len(apart), np.median(apart)) if len(apart) else apart
    if len(apart) < SEVERAL:
        return np.asarray(usual)
    local = median_filter(apart, size=2 * SEVERAL - 1, mode="nearest")
    alike = (np.abs(apart - local) < ALIKE * local) & (local > SLOWER * usual)
    around = binary_dilation(binary_opening(alike, np.ones(SEVERAL)), np.ones(2 * SEVERAL - 1))
    return np.where(around & (local > SLOWER * usual), local, usual)
