"""The maps of a reduced model besides its energy, fitted to equilibria: mass, viscosity, centre of mass, rotation."""

import logging
from typing import Any, NamedTuple

import numpy as np

from softrl.pod.maps import Seen, at_points, best_degree, elastic_factors, fit_map, symmetric_roots
from softrl.pod.settings import FitSettings
from softrl.pod.symmetry import Equilibria, images_of, reflected, symmetries
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
ROOT_RIDGE, MAP_RIDGE = 1e-8, 1e-12  # roots near the identity go on tamely beyond the samples; maps are exact
LAG_FLOOR = 0.005  # of the viscosity lags everywhere: keeps the root smooth at rest, where nothing else does


class Targets(NamedTuple):
    """What a map is fitted to: ``values`` (S, 1 + k, columns), the ``weight`` of each column in the choice of a degree.

    Where ``k`` is not zero, the change under the largest load of each kind follows the value.
    """

    values: np.ndarray
    weight: np.ndarray
    degree_max: int
    through_origin: bool
    ridge: float


def fit_maps(
    settings: FitSettings, robot: Robot, samples: Equilibria, frame: np.ndarray, fold: np.ndarray
) -> dict[str, Any]:
    """Return the coefficients of all maps besides the energy; each weighs the samples' images as predicts it best."""
    ratio, images = _lag_ratio(samples), images_of(robot)
    maps: dict[str, Any] = {"lag_ratio": ratio}
    least: dict[str, float] = {}
    identity = symmetries(robot.chamber_direction)[:1]
    everything = reflected(samples, [*identity, *images])
    largest = np.abs(everything.load).max(axis=0)
    goals = _targets(settings, everything, frame, ratio, largest)
    still = at_points(np.linalg.solve(frame, everything.coordinate.T).T)
    moving = Seen(still.points, np.linalg.solve(frame, everything.compliance) * largest)
    folds = np.tile(fold, 1 + len(images))
    own = slice(0, len(fold))
    for image_weight in settings.image_weights_of(robot):
        rows = slice(0, len(folds) if image_weight else len(fold))
        weight = np.where(np.arange(len(folds)) < len(fold), 1.0, image_weight)[rows]
        for name, goal in goals.items():
            values = goal.values[rows]
            seen = (moving if values.shape[1] > 1 else still).rows(rows)
            shape = goal.through_origin, goal.ridge
            found = best_degree(seen, values / goal.weight, weight, folds[rows], own, goal.degree_max, *shape)
            if found.error < least.get(name, np.inf):
                least[name] = found.error
                maps[name] = fit_map(seen, values, weight, found.degree, *shape)
                log.debug("%s of degree %d with images of weight %g", name, found.degree, image_weight)
    return maps


def _targets(
    settings: FitSettings, images: Equilibria, frame: np.ndarray, ratio: float, largest: np.ndarray
) -> dict[str, Targets]:
    """Return by name what the maps are fitted to; ``largest`` (n + 3,) Pa and N are the largest loads.

    Viscosity is seen beside the elastic Hessian, which it equals at rest and whose stiff directions it shares wherever
    they turn: in these terms low degrees predict it three times better. Of the centre of mass the slope counts, by which
    weight loads the body.
    """
    elastic = frame.T @ np.linalg.inv(images.compliance) @ frame
    viscous = frame.T @ images.stiffness @ frame
    lag = _beside_gives(images)
    lagging = frame.T @ lag.stiffness @ frame / ratio + LAG_FLOOR * viscous
    mass = frame.T @ images.mass @ frame
    factor = np.linalg.cholesky(mass.mean(axis=0))
    inverse = np.linalg.inv(factor)
    weight = np.tile(np.sqrt(np.diag((elastic + viscous).mean(axis=0))), len(frame))
    roots = symmetric_roots(inverse @ mass @ inverse.T) @ factor.T
    goals = {"mass_root": Targets(_flat(roots), weight, settings.root_degree_max, False, ROOT_RIDGE)}
    elastic_factor = elastic_factors(elastic)
    apart = np.linalg.inv(elastic_factor)
    for name, matrices in (("lag_root", lagging), ("stiffness_root", viscous - lagging)):
        tough = symmetric_roots(apart @ matrices @ apart.transpose(0, 2, 1))
        goals[name] = Targets(_flat(tough), np.ones(tough[0].size), settings.root_degree_max, False, ROOT_RIDGE)
    tough = tough @ elastic_factor.transpose(0, 2, 1)
    for name, root, across, own in (
        ("give_root", roots, images.give_coupling, images.give_mass),
        ("drag_root", tough, images.give_drag, images.give_viscosity),
    ):
        rows = _flat(_rows_beside(root, across @ frame, own))
        goals[name] = Targets(rows, np.ones(rows.shape[2]), settings.root_degree_max, False, ROOT_RIDGE)
    goals["give"] = Targets(_flat(symmetric_roots(images.give)), np.ones(9), settings.root_degree_max, False, ROOT_RIDGE)
    for name, values, slopes, degree_max in (
        ("centre_of_mass", images.centre_of_mass, images.centre_slope, settings.energy_degree_max),
        ("rotation", images.rotation, images.rotation_slope, settings.map_degree_max),
    ):
        both = np.concatenate([values[:, None], slopes.transpose(0, 2, 1) * largest[:, None]], axis=1)
        goals[name] = Targets(both, np.ones(3), degree_max, True, MAP_RIDGE)
    for name, values, through_origin in (
        ("lag_rotation", lag.spin @ frame, True),
        ("give_rotation", images.give_spin, False),
    ):
        flat = _flat(values)
        goals[name] = Targets(flat, np.ones(flat.shape[2]), settings.map_degree_max, through_origin, MAP_RIDGE)
    return goals


class Lag(NamedTuple):
    """What lags beside what gives: (S, r, r) stiffness and viscosity, (S, 3, r) turn of the tip; see ``Equilibria``."""

    stiffness: np.ndarray
    viscosity: np.ndarray
    spin: np.ndarray


def _beside_gives(samples: Equilibria) -> Lag:
    """Return the lags without their share in the shapes by which the body gives; nothing is taken where nothing gives."""
    shared = np.linalg.pinv(samples.give) @ samples.give_drag
    return Lag(
        samples.lag_stiffness - shared.transpose(0, 2, 1) @ samples.give @ shared,
        samples.lag_viscosity - shared.transpose(0, 2, 1) @ samples.give_viscosity @ shared,
        samples.lag_spin + samples.give_spin @ shared,
    )


def _rows_beside(root: np.ndarray, across: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return A above B (S, r + 3, 3) with R'A = ``across``' (S, r, 3) and A'A + B'B = ``own`` (S, 3, 3), R the ``root``."""
    above = np.linalg.solve(root.transpose(0, 2, 1), across.transpose(0, 2, 1))
    return np.concatenate([above, symmetric_roots(own - above.transpose(0, 2, 1) @ above)], axis=1)


def _flat(values: np.ndarray) -> np.ndarray:
    """Return matrices (S, rows, columns) as values of a map without slopes (S, 1, rows columns)."""
    return values.reshape(len(values), 1, -1)


def _lag_ratio(samples: Equilibria) -> float:
    """Return the viscosity of the lags over their stiffness, one number for all: 1 where nothing lags."""
    lag = _beside_gives(samples)
    stiffness = float(np.einsum("sij,sji->", samples.compliance, lag.stiffness))
    viscosity = float(np.einsum("sij,sji->", samples.compliance, lag.viscosity))
    return viscosity / stiffness if stiffness > 0.0 else 1.0
