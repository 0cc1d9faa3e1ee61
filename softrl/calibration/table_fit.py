"""Fit a body to a table of pressures and tips: its modulus, and where it stands in the table's frame.

Without weight a hyperelastic body's shape depends on pressure over modulus alone, so equilibria at one modulus serve
for all: a polynomial through them is the body, and only the modulus and a rigid motion are sought.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError


@dataclass(frozen=True)
class BodyMap:
    """Tip displacement of a body by pressure over modulus, a polynomial without constant.

    Attributes
    ----------
    scale_pa : pressure that counts as one
    youngs_modulus_pa : of the body whose equilibria were fitted
    coefficients : (terms, 3) m
    degree : of the polynomial
    """

    scale_pa: float
    youngs_modulus_pa: float
    coefficients: np.ndarray
    degree: int

    def tip(self, pressure: np.ndarray, youngs_modulus_pa: float) -> np.ndarray:
        """Return the tip's displacement (rows, 3) m under ``pressure`` (rows, chambers) Pa."""
        scaled = pressure * self.youngs_modulus_pa / (youngs_modulus_pa * self.scale_pa)
        return _terms(scaled, self.degree) @ self.coefficients


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
    """

    youngs_modulus_pa: float
    order: tuple[int, ...]
    rotation: np.ndarray
    origin_m: np.ndarray
    train_rmse_m: float
    heldout_rmse_m: float
    still_rmse_m: float


def body_map(pressure: np.ndarray, tip: np.ndarray, youngs_modulus_pa: float, degree: int) -> tuple[BodyMap, float]:
    """Return the map through equilibria, and its cross-validated error in m, root mean square.

    Parameters
    ----------
    pressure, tip : (samples, chambers) Pa, (samples, 3) m displacement of the tip
    degree : of the polynomial; it needs more samples than terms
    """
    scale = float(np.abs(pressure).max())
    terms = _terms(pressure / scale, degree)
    if len(terms) <= terms.shape[1]:
        raise ConfigError(f"degree={degree} has {terms.shape[1]} terms, more than {len(terms) - 1} samples can fix")
    solution = np.linalg.lstsq(terms, tip, rcond=None)[0]
    # leaving one out changes its residual by its leverage
    leverage = np.einsum("ij,ji->i", terms, np.linalg.pinv(terms))
    miss = (tip - terms @ solution) / np.maximum(1.0 - leverage, 1e-9)[:, None]
    return BodyMap(scale, youngs_modulus_pa, solution, degree), _rms(miss)


def fit_table(body: BodyMap, pressure: np.ndarray, tip: np.ndarray, train: np.ndarray) -> TableFit:
    """Return the modulus and rigid motion that bring ``body`` to the rows ``train`` of a table.

    Parameters
    ----------
    pressure, tip : (rows, chambers) Pa, (rows, 3) m position of the tip
    train : (rows,) bool; the other rows are only looked at afterwards
    """
    best: tuple[float, float, tuple[int, ...]] | None = None
    for order in permutations(range(pressure.shape[1])):
        for log_modulus in (-0.5, 0.0, 0.5):
            found = least_squares(
                lambda x, order=order: (
                    _placed(body, pressure[train][:, order], tip[train], np.exp(x[0]))[0] - tip[train]
                ).ravel(),
                [np.log(body.youngs_modulus_pa) + log_modulus],
            )
            if best is None or found.cost < best[0]:
                best = (found.cost, float(np.exp(found.x[0])), order)
    assert best is not None
    _, modulus, order = best
    _, rotation, origin = _placed(body, pressure[train][:, order], tip[train], modulus)
    miss = body.tip(pressure[:, order], modulus) @ rotation.T + origin - tip
    still = tip[~train] - tip[train].mean(axis=0)
    return TableFit(modulus, order, rotation, origin, _rms(miss[train]), _rms(miss[~train]), _rms(still))


def _placed(
    body: BodyMap, pressure: np.ndarray, tip: np.ndarray, modulus: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the body's tips in the table's frame, and the rigid motion that fits them best."""
    own = body.tip(pressure, modulus)
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
