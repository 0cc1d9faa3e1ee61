"""From equilibria to a reduced model: degree, ridge and weight of symmetry are chosen by cross-validation.

Images of the samples under the robot's symmetries are further samples, of less weight: a mesh is never quite symmetric,
which full weight overlooks, but where there are few samples their images say how the body goes on.
"""

import logging
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.stats.qmc import Sobol

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError
from softrl.pod.basis import PodBasis
from softrl.pod.energy import Normal, Weights, accumulate, frame_of, scale_of, solve
from softrl.pod.kernel import run_kernel
from softrl.pod.maps import best_degree, elastic_factors, fit_map, symmetric_roots
from softrl.pod.potential import Tables, fill_potential
from softrl.pod.rom import EMPTY, elastic_hessian_at_rest, no_hooks, static_points, tables_of
from softrl.pod.symmetry import Equilibria, Symmetry, reflected, symmetries
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
LOST = 0.1  # of the rms motion: an equilibrium farther off counts as lost, however far it is
PRESSURES = 512  # all over their range, at which the body has to stand
THROW_STEPS, THROW_STEP = 40, 0.4  # under each load, in radians of the slowest motion at rest
ROOT_RIDGE, MAP_RIDGE = 1e-8, 1e-12  # roots near the identity go on tamely beyond the samples; maps are exact
LAG_FLOOR = 0.005  # of the viscosity lags everywhere: keeps the root smooth at rest, where nothing else does


@dataclass(frozen=True)
class FitSettings:
    """How the maps are fitted.

    Attributes
    ----------
    energy_degree_max, map_degree_max, root_degree_max : highest degree tried for the energy, for centre of mass and
        rotation, and for the roots of mass and stiffness
    ridges : ridges tried for the energy, relative
    image_weights : weights tried for the samples' images under the robot's symmetries; a sample has 1
    weights : of values and Hessians against gradients
    folds : parts of the cross-validation
    """

    energy_degree_max: int
    map_degree_max: int
    root_degree_max: int
    ridges: tuple[float, ...]
    image_weights: tuple[float, ...]
    weights: Weights
    folds: int


class Choice(NamedTuple):
    """A candidate energy, with the rms error m of the tip at equilibria that its fit did not see."""

    image_weight: float
    degree: int
    ridge: float
    tip_error_m: float


def fit_model(
    settings: FitSettings,
    robot: Robot,
    snapshots: Snapshots,
    samples: Equilibria,
    pod: PodBasis,
    rng: np.random.Generator,
) -> tuple[ReducedModel, list[Choice]]:
    """Return the reduced model of the equilibria ``samples``, and every energy that was tried, best first."""
    if len(samples.load) < settings.folds:
        raise ConfigError(
            f"{len(samples.load)} equilibria are too few for stage.folds={settings.folds}; run stage=fem with more"
        )
    fold = rng.permutation(np.arange(len(samples.load)) % settings.folds)
    frame = frame_of(samples)
    draft = _draft(robot, snapshots, samples, pod, frame)
    own, images = _fold_normals(settings, robot, samples, frame, fold)
    draft = replace(draft, **_fit_maps(settings, robot, samples, frame, fold))
    choices = _tried(settings, draft, samples, fold, (own, images))
    best = _first_that_settles(draft, samples, choices, (own, images))
    energy = solve(_weighed(own, images, best.image_weight), draft.order, best.degree, best.ridge)
    if not _stands(replace(draft, energy=energy)):
        log.warning(
            "no energy fitted to %d equilibria is stable at rest; the reduced model is linear, from the compliance of "
            "the equilibrium nearest to rest: run stage=fem with more equilibria",
            len(samples.load),
        )
        energy = _linear_energy(samples, frame)
        errors = _squared_tip_errors(replace(draft, energy=energy), samples)
        best = Choice(0.0, 2, 0.0, float(np.sqrt(errors.mean())))
        choices.insert(0, best)
    return replace(draft, energy=energy, symmetry="all" if best.image_weight else "none"), choices


def tell_choice(model: ReducedModel, samples: Equilibria, best: Choice) -> None:
    """Log what was chosen, and warn of wells."""
    if not _settles(model, samples):
        log.warning("every energy has wells beyond its samples, in which a fast motion may be caught: more equilibria help")
    log.info(
        "energy of degree %d, ridge %g, images of weight %g: tip %.3f mm in cross-validation over %d equilibria",
        best.degree,
        best.ridge,
        best.image_weight,
        1e3 * best.tip_error_m,
        len(samples.load),
    )


def linear_model(model: ReducedModel) -> ReducedModel:
    """Return the baseline: ``model`` linearised at rest, with constant mass and damping."""
    r = model.order
    few = 1 + r + r * (r + 1) // 2
    return replace(
        model,
        energy=model.energy[:few].copy(),
        mass_root=model.mass_root[:, :1].copy(),
        stiffness_root=model.stiffness_root[:, :1].copy(),
        lag_root=model.lag_root[:, :0].copy(),
        lag_rotation=model.lag_rotation[:, :0].copy(),
        centre_of_mass=model.centre_of_mass[:, : 1 + r].copy(),
        rotation=model.rotation[:, : 1 + r].copy(),
    )


def _images(robot: Robot) -> list[Symmetry]:
    """Return the robot's symmetries besides the identity; they are about z."""
    return symmetries(robot.chamber_direction)[1:] if robot.axis in ("+z", "-z") else []


def _image_weights(settings: FitSettings, robot: Robot) -> tuple[float, ...]:
    return settings.image_weights if _images(robot) else (0.0,)


def _draft(robot: Robot, snapshots: Snapshots, samples: Equilibria, pod: PodBasis, frame: np.ndarray) -> ReducedModel:
    """Return the model before its maps are fitted."""
    r = len(frame)
    return ReducedModel(
        frame=frame,
        energy=np.zeros(1 + r),
        mass_root=np.eye(r).reshape(-1, 1),
        stiffness_root=np.zeros((r * r, 1)),
        lag_root=np.zeros((r * r, 0)),
        lag_ratio=1.0,
        lag_rotation=np.zeros((3 * r, 0)),
        centre_of_mass=np.zeros((3, 1 + r)),
        rotation=np.zeros((3, 1)),
        rest_tip=snapshots.rest_tip,
        rest_volume=snapshots.rest_volume,
        mass=snapshots.mass,
        gravity_m_s2=np.array(robot.gravity_m_s2, dtype=float),
        pressure_min_pa=robot.pressure_min_pa,
        pressure_max_pa=robot.pressure_max_pa,
        load_low=samples.load.min(axis=0),
        load_high=samples.load.max(axis=0),
        rayleigh_mass_per_s=snapshots.rayleigh_mass_per_s,
        rayleigh_stiffness_s=snapshots.rayleigh_stiffness_s,
        youngs_modulus_pa=snapshots.youngs_modulus_pa,
        symmetry="none",
        modes=pod.modes.astype(np.float32),
        singular_values=pod.singular_values,
        robot_name=snapshots.robot_name,
    )


def _fold_normals(
    settings: FitSettings, robot: Robot, samples: Equilibria, frame: np.ndarray, fold: np.ndarray
) -> tuple[list[Normal], list[Normal]]:
    """Return the equations of each fold's samples, and of their images; all folds but one are the sum less that one."""
    scale, degree, images = scale_of(samples), settings.energy_degree_max, _images(robot)
    parts = [samples.rows(fold == part) for part in range(settings.folds)]
    own = [accumulate(part, frame, scale, degree, settings.weights) for part in parts]
    if not images:
        return own, [Normal(0.0 * n.matrix, 0.0 * n.right) for n in own]
    return own, [accumulate(reflected(part, images), frame, scale, degree, settings.weights) for part in parts]


def _weighed(own: list[Normal], images: list[Normal], weight: float) -> Normal:
    """Return the equations of the samples and of their images together."""
    return Normal(
        sum(n.matrix for n in own) + weight * sum(n.matrix for n in images),
        sum(n.right for n in own) + weight * sum(n.right for n in images),
    )


def _tried(
    settings: FitSettings,
    draft: ReducedModel,
    samples: Equilibria,
    fold: np.ndarray,
    normals: tuple[list[Normal], list[Normal]],
) -> list[Choice]:
    """Return the candidates by rising error of the tip in cross-validation.

    First all weights of images and degrees at the middle ridge, then the other ridges at the best weight, near its
    degree.
    """
    own, images = normals
    weights = settings.image_weights if any(n.right.any() for n in images) else (0.0,)
    farthest = LOST**2 * float((samples.coordinate[:, -3:] ** 2).sum(axis=1).mean())
    seen = {}
    for weight in weights:
        total = _weighed(own, images, weight)
        parts = [_weighed([a], [b], weight) for a, b in zip(own, images, strict=True)]
        seen[weight] = [Normal(total.matrix - part.matrix, total.right - part.right) for part in parts]

    def tried(weight: float, degree: int, ridge: float) -> Choice:
        squares = 0.0
        for part, normal in enumerate(seen[weight]):
            energy = solve(normal, draft.order, degree, ridge)
            errors = _squared_tip_errors(replace(draft, energy=energy), samples.rows(fold == part))
            squares += np.minimum(errors, farthest).sum()
        return Choice(weight, degree, ridge, float(np.sqrt(squares / len(fold))))

    ridges = sorted(settings.ridges)
    middle = ridges.pop(len(ridges) // 2)
    degrees = range(2, settings.energy_degree_max + 1)
    choices = [tried(weight, degree, middle) for weight in seen for degree in degrees]
    best = min(choices, key=lambda choice: choice.tip_error_m)
    near = [degree for degree in degrees if abs(degree - best.degree) <= 1]
    choices += [tried(best.image_weight, degree, ridge) for degree in near for ridge in ridges]
    return sorted(choices, key=lambda choice: choice.tip_error_m)


def _first_that_settles(
    draft: ReducedModel, samples: Equilibria, choices: list[Choice], normals: tuple[list[Normal], list[Normal]]
) -> Choice:
    """Move the best choice whose body is at rest only where it should be to the front of ``choices``; return it.

    A polynomial may have further wells beyond the samples. Statics from rest does not find them; a motion falls in.
    """
    for number, choice in enumerate(choices):
        energy = solve(_weighed(*normals, choice.image_weight), draft.order, choice.degree, choice.ridge)
        if _settles(replace(draft, energy=energy), samples):
            choices.insert(0, choices.pop(number))
            return choice
    return choices[0]


def _settles(model: ReducedModel, samples: Equilibria) -> bool:
    """Return whether the body, thrown from load to load under its weight and well damped, comes to rest where statics says.

    Loads are those of the samples and pressures all over their range.
    """
    if not _stands(model):
        return False
    root = np.linalg.inv(np.linalg.cholesky(elastic_hessian_at_rest(model)))
    mass = model.mass_root[:, 0].reshape(model.order, model.order)
    slowest = 1.0 / np.sqrt(np.linalg.eigvalsh(root @ mass.T @ mass @ root.T)[-1])
    damped = replace(model, rayleigh_mass_per_s=max(model.rayleigh_mass_per_s, slowest))
    span = model.pressure_max_pa - model.pressure_min_pa
    pressures = np.zeros((PRESSURES, model.order))
    pressures[:, : model.chambers] = model.pressure_min_pa + span * Sobol(model.chambers, seed=0).random(PRESSURES)
    loads = np.concatenate([samples.load, pressures])
    tables, held = tables_of(damped), np.repeat(loads, THROW_STEPS, axis=0)
    path = np.empty_like(held)
    failed, _ = run_kernel(*np.zeros((4, model.order)), THROW_STEP / slowest, held, tables, no_hooks(), path, *EMPTY)
    points, lost = static_points(tables, loads)
    apart = np.linalg.norm(((path[THROW_STEPS - 1 :: THROW_STEPS] - points) @ model.frame.T)[:, -3:], axis=1)
    near = LOST * np.sqrt((samples.coordinate[:, -3:] ** 2).sum(axis=1).mean())
    return not lost.any() and failed == 0 and bool((apart < near).all()) and _least_stiffness(tables, points) > 0.0


def _least_stiffness(tables: Tables, points: np.ndarray) -> float:
    """Return the smallest eigenvalue of the potential's Hessian at ``points`` (S, r), J: negative at a saddle."""
    r = points.shape[1]
    values, inside, gradient, hessian = np.empty(len(tables.parent)), np.empty(r), np.empty(r), np.empty((r, r))
    least = np.inf
    for point in points:
        fill_potential(point, tables, values, inside, gradient, hessian)
        least = min(least, float(np.linalg.eigvalsh(hessian)[0]))
    return least


def _squared_tip_errors(model: ReducedModel, samples: Equilibria) -> np.ndarray:
    """Return the squared tip errors (S,) m^2; an equilibrium that is not found counts as the whole motion."""
    n = model.chambers
    if not _stands(model):
        return np.full(len(samples.load), np.inf)
    points, failed = static_points(tables_of(model, np.zeros(3)), samples.load)
    errors = (((points @ model.frame.T) - samples.coordinate)[:, n:] ** 2).sum(axis=1)
    return np.where(failed, np.maximum(errors, (samples.coordinate[:, n:] ** 2).sum(axis=1)), errors)


def _stands(model: ReducedModel) -> bool:
    """Return whether the body is stable at rest."""
    return bool(np.linalg.eigvalsh(elastic_hessian_at_rest(model)).min() > 0.0)


def _linear_energy(samples: Equilibria, frame: np.ndarray) -> np.ndarray:
    """Return the coefficients (monomials,) J of half y' H y with H from the equilibrium nearest to rest."""
    r = len(frame)
    nearest = int(np.argmin(np.linalg.norm(np.linalg.solve(frame, samples.coordinate.T), axis=0)))
    hessian = frame.T @ np.linalg.inv(samples.compliance[nearest]) @ frame
    rows, columns = np.triu_indices(r)
    return np.r_[np.zeros(r + 1), hessian[rows, columns] * np.where(rows == columns, 0.5, 1.0)]


class Targets(NamedTuple):
    """What a map is fitted to: ``values`` (S, columns) and the ``weight`` of each column in the choice of a degree."""

    values: np.ndarray
    weight: np.ndarray
    degree_max: int
    through_origin: bool
    ridge: float


def _fit_maps(
    settings: FitSettings, robot: Robot, samples: Equilibria, frame: np.ndarray, fold: np.ndarray
) -> dict[str, Any]:
    """Return the coefficients of all maps besides the energy; each weighs the samples' images as predicts it best."""
    ratio, images = _lag_ratio(samples), _images(robot)
    maps: dict[str, Any] = {"lag_ratio": ratio}
    least: dict[str, float] = {}
    identity = symmetries(robot.chamber_direction)[:1]
    everything = reflected(samples, [*identity, *images])
    goals = _targets(settings, everything, frame, ratio)
    points, folds = np.linalg.solve(frame, everything.coordinate.T).T, np.tile(fold, 1 + len(images))
    own = slice(0, len(fold))
    for image_weight in _image_weights(settings, robot):
        rows = slice(0, len(folds) if image_weight else len(fold))
        weight = np.where(np.arange(len(folds)) < len(fold), 1.0, image_weight)[rows]
        for name, goal in goals.items():
            values = goal.values[rows]
            found = best_degree(
                points[rows], values / goal.weight, weight, folds[rows], own, goal.degree_max, goal.through_origin, goal.ridge
            )
            if found.error < least.get(name, np.inf):
                least[name] = found.error
                maps[name] = fit_map(points[rows], values, weight, found.degree, goal.through_origin, goal.ridge)
                log.debug("%s of degree %d with images of weight %g", name, found.degree, image_weight)
    return maps


def _targets(settings: FitSettings, images: Equilibria, frame: np.ndarray, ratio: float) -> dict[str, Targets]:
    """Return by name what the maps are fitted to.

    Viscosity is seen beside the elastic Hessian, which it equals at rest and whose stiff directions it shares wherever
    they turn: in these terms low degrees predict it three times better.
    """
    elastic = frame.T @ np.linalg.inv(images.compliance) @ frame
    viscous = frame.T @ images.stiffness @ frame
    lagging = frame.T @ images.lag_stiffness @ frame / ratio + LAG_FLOOR * viscous
    mass = frame.T @ images.mass @ frame
    factor = np.linalg.cholesky(mass.mean(axis=0))
    inverse = np.linalg.inv(factor)
    weight = np.tile(np.sqrt(np.diag((elastic + viscous).mean(axis=0))), len(frame))
    roots = symmetric_roots(inverse @ mass @ inverse.T) @ factor.T
    goals = {"mass_root": Targets(roots.reshape(len(mass), -1), weight, settings.root_degree_max, False, ROOT_RIDGE)}
    apart = np.linalg.inv(elastic_factors(elastic))
    for name, matrices in (("stiffness_root", viscous - lagging), ("lag_root", lagging)):
        roots = symmetric_roots(apart @ matrices @ apart.transpose(0, 2, 1)).reshape(len(mass), -1)
        goals[name] = Targets(roots, np.ones(roots.shape[1]), settings.root_degree_max, False, ROOT_RIDGE)
    for name, values in (
        ("centre_of_mass", images.centre_of_mass),
        ("rotation", images.rotation),
        ("lag_rotation", (images.lag_spin @ frame).reshape(len(images.load), -1)),
    ):
        goals[name] = Targets(values, np.ones(values.shape[1]), settings.map_degree_max, True, MAP_RIDGE)
    return goals


def _lag_ratio(samples: Equilibria) -> float:
    """Return the viscosity of the lags over their stiffness, one number for all: 1 where nothing lags."""
    stiffness = float(np.einsum("sij,sji->", samples.compliance, samples.lag_stiffness))
    viscosity = float(np.einsum("sij,sji->", samples.compliance, samples.lag_viscosity))
    return viscosity / stiffness if stiffness > 0.0 else 1.0
