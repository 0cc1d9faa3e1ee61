"""Fit a body to a table of pressures and tips: its modulus, and where it stands in the table's frame.

Without weight a hyperelastic body's shape depends on pressure over modulus alone, so equilibria at one modulus serve
for all: a polynomial through them is the body, and only the modulus and a rigid motion are sought. The table's point may
also lie a reach beyond the body's own tip, where it swings wider as the plate turns.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError

REACH_UNIT_M = 0.1  # so that the search steps alike in the modulus' logarithm and in the reach


@dataclass(frozen=True)
class BodyMap:
    """Tip displacement of a body by pressure over modulus, a polynomial without constant.

    Attributes
    ----------
    scale_pa : pressure that counts as one
    youngs_modulus_pa : of the body whose equilibria were fitted
    coefficients : (terms, 3) m
    degree : of the polynomial
    turns : (terms, 3) rad, of the plate's rotation vector; None where it is not known
    """

    scale_pa: float
    youngs_modulus_pa: float
    coefficients: np.ndarray
    degree: int
    turns: np.ndarray | None = None

    def tip(self, pressure: np.ndarray, youngs_modulus_pa: float, reach_m: float = 0.0) -> np.ndarray:
        """Return how far (rows, 3) m ``pressure`` (rows, chambers) Pa moves the point ``reach_m`` beyond the tip."""
        scaled = pressure * self.youngs_modulus_pa / (youngs_modulus_pa * self.scale_pa)
        terms = _terms(scaled, self.degree)
        moved = terms @ self.coefficients
        if self.turns is None:
            return moved
        ahead = np.array([0.0, 0.0, reach_m])
        return moved + Rotation.from_rotvec(terms @ self.turns).apply(ahead) - ahead


@dataclass(frozen=True)
class TableFit:
    """What was found, and how well it holds.

    Attributes
    ----------
    youngs_modulus_pa : the modulus that moves the body as the table says
    order : which of the table's pressures goes into each chamber
    rotation : (3, 3) from the body's frame into the table's
    origin_m : (3,) the tip under no pressure, in the table's frame
    train_rmse_m, heldout_rmse_m : root mean square of the tip's distance
    still_rmse_m : the same on the held-out rows if the tip never moved
    reach_m : how far beyond the body's tip the table's point lies; 0 where it was not sought
    """

    youngs_modulus_pa: float
    order: tuple[int, ...]
    rotation: np.ndarray
    origin_m: np.ndarray
    train_rmse_m: float
    heldout_rmse_m: float
    still_rmse_m: float
    reach_m: float = 0.0


def body_map(
    pressure: np.ndarray, tip: np.ndarray, youngs_modulus_pa: float, degree: int, turn: np.ndarray | None = None
) -> tuple[BodyMap, float]:
    """Return the map through equilibria, and the cross-validated error of its tip in m, root mean square.

    Parameters
    ----------
    pressure, tip : (samples, chambers) Pa, (samples, 3) m displacement of the tip
    degree : of the polynomial; it needs more samples than terms
    turn : (samples, 3) rad, rotation vector of the plate, where a reach beyond the tip is to be sought
    """
    scale = float(np.abs(pressure).max())
    terms = _terms(pressure / scale, degree)
    if len(terms) <= terms.shape[1]:
        raise ConfigError(f"degree={degree} has {terms.shape[1]} terms, more than {len(terms) - 1} samples can fix")
    solution = np.linalg.lstsq(terms, tip, rcond=None)[0]
    turns = None if turn is None else np.linalg.lstsq(terms, turn, rcond=None)[0]
    # leaving one out changes its residual by its leverage
    leverage = np.einsum("ij,ji->i", terms, np.linalg.pinv(terms))
    miss = (tip - terms @ solution) / np.maximum(1.0 - leverage, 1e-9)[:, None]
    return BodyMap(scale, youngs_modulus_pa, solution, degree, turns), _rms(miss)


def fit_table(
    body: BodyMap, pressure: np.ndarray, tip: np.ndarray, train: np.ndarray, seek_reach: bool = False
) -> TableFit:
    """Return the modulus and rigid motion that bring ``body`` to the rows ``train`` of a table.

    Parameters
    ----------
    pressure, tip : (rows, chambers) Pa, (rows, 3) m position of the tip
    train : (rows,) bool; the other rows are only looked at afterwards
    seek_reach : whether the table's point may lie beyond the body's tip, along its axis
    """
    if seek_reach and body.turns is None:
        raise ConfigError("seek_reach needs the turns of the plate; give them to body_map")
    best: tuple[float, np.ndarray, tuple[int, ...]] | None = None
    for order in permutations(range(pressure.shape[1])):

        def miss(x: np.ndarray, order: tuple[int, ...] = order) -> np.ndarray:
            own = body.tip(pressure[train][:, order], np.exp(x[0]), *(REACH_UNIT_M * x[1:]))
            return (_placed(own, tip[train])[0] - tip[train]).ravel()

        for log_modulus in (-0.5, 0.0, 0.5):
            start = [np.log(body.youngs_modulus_pa) + log_modulus, *([0.0] if seek_reach else [])]
            found = least_squares(miss, start)
            if best is None or found.cost < best[0]:
                best = (found.cost, found.x, order)
    assert best is not None
    _, x, order = best
    modulus, reach = float(np.exp(x[0])), float(REACH_UNIT_M * x[1:].sum())
    own = body.tip(pressure[:, order], modulus, reach)
    _, rotation, origin = _placed(own[train], tip[train])
    left = own @ rotation.T + origin - tip
    still = tip[~train] - tip[train].mean(axis=0)
    return TableFit(modulus, order, rotation, origin, _rms(left[train]), _rms(left[~train]), _rms(still), reach)


def _placed(own: np.ndarray, tip: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the body's tips in the table's frame, and the rigid motion that fits them best."""
    turn, _ = Rotation.align_vectors(tip - tip.mean(axis=0), own - own.mean(axis=0))
    rotation = turn.as_matrix()
    origin = tip.mean(axis=0) - rotation @ own.mean(axis=0)
    return own @ rotation.T + origin, rotation, origin


def _terms(scaled: np.ndarray, degree: int) -> np.ndarray:
    """Return the monomials (rows, terms) of degree 1 to ``degree``."""
    width = scaled.shape[1]
    columns = [
        np.prod(scaled[:, list(chosen)], axis=1)
        for power in range(1, degree + 1)
        for chosen in combinations_with_replacement(range(width), power)
    ]
    return np.stack(columns, axis=1)


def _rms(miss: np.ndarray) -> float:
    return float(np.sqrt((miss**2).sum(axis=1).mean()))
