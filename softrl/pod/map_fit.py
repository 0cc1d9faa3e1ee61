"""The maps of a reduced model besides its energy, fitted to equilibria: mass, viscosity, centre of mass, rotation."""

import logging
from typing import Any, NamedTuple

import numpy as np

from softrl.pod.equilibria import Answers, Equilibria, slopes_of
from softrl.pod.maps import Seen, best_form, elastic_factors, equations, symmetric_roots
from softrl.pod.settings import FitSettings
from softrl.pod.symmetry import reflected, weight_to_trust
from softrl.robots.robot import Robot
from softrl.robots.symmetry import images_of, symmetries

log = logging.getLogger(__name__)
RIDGES = (1e-10, 1e-8, 1e-7, 1e-6, 1e-5)  # tried for every map


class Kind(NamedTuple):
    """How a map is fitted: the highest degree tried, and whether it vanishes at rest."""

    degree_max: int
    through_origin: bool


def fit_maps(
    settings: FitSettings, robot: Robot, samples: Equilibria, frame: np.ndarray, fold: np.ndarray
) -> dict[str, Any]:
    """Return the coefficients of all maps besides the energy; each weighs the samples' images as they deserve.

    A map is fitted to its values at the equilibria and, where that is known, to how it changes under the largest load of
    each kind.
    """
    images, kinds = images_of(robot), _kinds(settings)
    everything = reflected(samples, [*symmetries(robot.chamber_direction)[:1], *images])
    largest = np.abs(everything.load).max(axis=0)
    terms = Terms(frame, _mean_factor(everything, frame))
    goals = _goals(everything, terms, largest)
    goals["stiffness_root_by_gravity"] = _stiffness_root_by_gravity(everything.answers, terms)
    seen = Seen(
        np.linalg.solve(frame, everything.coordinate.T).T, np.linalg.solve(frame, everything.compliance) * largest
    )
    weights = {"mass_root": _coordinate_weights(everything, frame)}
    folds = np.tile(fold, 1 + len(images))
    own = slice(0, len(fold))
    maps: dict[str, Any] = {}
    for name, kind in kinds.items():
        parts = {weight: _part(weight, seen, goals[name], len(fold)) for weight in settings.image_weights_of(robot)}
        forms = {
            weight: best_form(here, values / weights.get(name, 1.0), each, folds[: len(each)], own, *kind, RIDGES)
            for weight, (here, values, each) in parts.items()
        }
        trusted = weight_to_trust({weight: np.sqrt(form.error) for weight, form in forms.items()})
        form = forms[trusted]
        maps[name] = equations(*parts[trusted], form.degree, kind.through_origin).solve(form.ridge)
        log.debug("%s of degree %d, ridge %g, images of weight %g", name, form.degree, form.ridge, trusted)
    return maps


def _part(image_weight: float, seen: Seen, goal: np.ndarray, own: int) -> tuple[Seen, np.ndarray, np.ndarray]:
    """Return where, what and with which weight (S,) a map is seen: ``own`` samples, and unless they weigh nothing images."""
    rows = slice(0, len(goal) if image_weight else own)
    weight = np.where(np.arange(len(goal)) < own, 1.0, image_weight)[rows]
    values = goal[rows]
    return Seen(seen.points[rows], seen.moves[rows, :, : values.shape[1] - 1]), values, weight


def _kinds(settings: FitSettings) -> dict[str, Kind]:
    tough, root = Kind(settings.viscosity_degree_max, False), Kind(settings.root_degree_max, False)
    exact = {
        "centre_of_mass": Kind(settings.energy_degree_max, True),
        "rotation": Kind(settings.map_degree_max, True),
        "give_rotation": Kind(settings.root_degree_max, False),
    }
    roots = dict.fromkeys(("mass_root", "give_root", "drag_root", "give", "stiffness_root_by_gravity"), root)
    return roots | {"stiffness_root": tough} | exact


class Terms(NamedTuple):
    """In what terms maps are seen: the frame, and a factor of the mean mass."""

    frame: np.ndarray
    mass_factor: np.ndarray


def _goals(images: Equilibria, terms: Terms, largest: np.ndarray) -> dict[str, np.ndarray]:
    """Return by name what the maps are fitted to (S, 1 + n + 3, columns): values, then changes under each load."""

    def values(answers: Answers) -> Answers:
        return _values(answers, terms)

    slopes = slopes_of(values, {name: images.answers[name] for name in images.slopes}, images.slopes, largest)
    return {
        name: np.concatenate([value[:, None], slopes[name] * largest[:, None]], axis=1)
        for name, value in values(images.answers).items()
    }


class Roots(NamedTuple):
    """Roots (S, r, r) of mass and of viscosity, the latter beside the elastic factor.

    Beside the elastic Hessian, which viscosity equals at rest and whose stiff directions it shares wherever they turn, low
    degrees predict it three times better.
    """

    mass: np.ndarray
    viscous: np.ndarray
    elastic_factor: np.ndarray


def _roots(answers: Answers, terms: Terms) -> Roots:
    frame, factor = terms.frame, terms.mass_factor
    viscous, mass = (frame.T @ answers[name] @ frame for name in ("stiffness", "mass"))
    inverse = np.linalg.inv(factor)
    elastic_factor = elastic_factors(frame.T @ np.linalg.inv(answers["compliance"]) @ frame)
    apart = np.linalg.inv(elastic_factor)
    beside = symmetric_roots(apart @ viscous @ apart.transpose(0, 2, 1))
    return Roots(symmetric_roots(inverse @ mass @ inverse.T) @ factor.T, beside, elastic_factor)


def _stiffness_root_by_gravity(answers: Answers, terms: Terms) -> np.ndarray:
    """Return the changes (S, 1, 3 r r) of the root of viscosity by unit gravity along each axis."""
    roots = _roots(answers, terms)
    apart = np.linalg.inv(roots.elastic_factor)[:, None]
    change = apart @ (terms.frame.T @ answers["viscosity_by_gravity"] @ terms.frame) @ apart.transpose(0, 1, 3, 2)
    return 0.5 * np.linalg.solve(roots.viscous[:, None], change).reshape(len(change), 1, -1)


def _values(answers: Answers, terms: Terms) -> Answers:
    """Return the values (S, columns) of every map whose slopes are known."""
    frame, roots = terms.frame, _roots(answers, terms)
    drag_across, give_across = answers["give_drag"] @ frame, answers["give_coupling"] @ frame
    viscous_root = roots.viscous @ roots.elastic_factor.transpose(0, 2, 1)
    values = {
        "mass_root": roots.mass,
        "stiffness_root": roots.viscous,
        "give_root": _rows_beside(roots.mass, give_across, answers["give_mass"]),
        "drag_root": _rows_beside(viscous_root, drag_across, answers["give_viscosity"]),
        "give": symmetric_roots(answers["give"]),
        "centre_of_mass": answers["centre_of_mass"],
        "rotation": answers["rotation"],
        "give_rotation": answers["give_spin"],
    }
    return {name: value.reshape(len(value), -1) for name, value in values.items()}


def _rows_beside(root: np.ndarray, across: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return A above B (S, r + 3, 3) with R'A = ``across``' (S, r, 3) and A'A + B'B = ``own`` (S, 3, 3), R the ``root``."""
    above = np.linalg.solve(root.transpose(0, 2, 1), across.transpose(0, 2, 1))
    return np.concatenate([above, symmetric_roots(own - above.transpose(0, 2, 1) @ above)], axis=1)


def _mean_factor(samples: Equilibria, frame: np.ndarray) -> np.ndarray:
    """Return the lower triangular factor of the mean mass per ``frame``."""
    return np.linalg.cholesky((frame.T @ samples.answers["mass"] @ frame).mean(axis=0))


def _coordinate_weights(samples: Equilibria, frame: np.ndarray) -> np.ndarray:
    """Return for each entry (r r,) of a root how stiff its column's coordinate is, for the choice of a degree."""
    stiff = frame.T @ (np.linalg.inv(samples.compliance) + samples.answers["stiffness"]) @ frame
    return np.tile(np.sqrt(np.diag(stiff.mean(axis=0))), len(frame))
