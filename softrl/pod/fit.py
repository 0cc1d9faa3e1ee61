"""From equilibria to a reduced model: degree, ridge and weight of symmetry are chosen by cross-validation.

Images of the samples under the robot's symmetries are further samples, of less weight: a mesh is never quite symmetric,
which full weight overlooks, but where there are few samples their images say how the body goes on.

A high degree follows the samples closely and may go astray between and beyond them, where weight and fast motion lead.
There it is held to the best energy of lower degree that stands everywhere: equilibria of that energy, under all
pressures and the tip forces that weight makes, are weak further samples, its *anchors*.
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
from softrl.pod.polynomial import basis, degree_of
from softrl.pod.potential import Tables, fill_potential
from softrl.pod.rom import EMPTY, elastic_hessian_at_rest, gradient_of, no_hooks, static_points, tables_of
from softrl.pod.symmetry import Equilibria, Symmetry, reflected, symmetries
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
LOST = 0.1  # of the rms motion: an equilibrium farther off counts as lost, however far it is
PRESSURES = 512  # all over their range, at which the body has to stand
ANCHORS, BEYOND = 256, 1.2  # equilibria to which a high degree is held; their pressures over the robot's range
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
    anchor_weights : weights tried for the anchors, all of them together against all samples
    weights : of values, Hessians and third derivatives against gradients
    folds : parts of the cross-validation
    """

    energy_degree_max: int
    map_degree_max: int
    root_degree_max: int
    ridges: tuple[float, ...]
    image_weights: tuple[float, ...]
    anchor_weights: tuple[float, ...]
    weights: Weights
    folds: int


class Choice(NamedTuple):
    """A candidate energy, with the rms error m of the tip at equilibria that its fit did not see."""

    image_weight: float
    anchor_weight: float
    degree: int
    ridge: float
    tip_error_m: float


class Candidates:
    """The energies that may be fitted: each is the solution of one set of normal equations.

    Attributes
    ----------
    image_weights : those that make a difference
    """

    def __init__(self, settings: FitSettings, robot: Robot, draft: ReducedModel, samples: Equilibria, fold: np.ndarray):
        self._settings, self._draft, self._samples, self._fold = settings, draft, samples, fold
        self._scale, images = scale_of(samples), _images(robot)
        self.image_weights = _image_weights(settings, robot)
        parts = [samples.rows(fold == part) for part in range(settings.folds)]
        self._own = [self._equations(part) for part in parts]
        self._images = [self._equations(reflected(part, images)) for part in parts] if images else []
        self._anchors: np.ndarray | None = None
        self._low: list[np.ndarray] = []
        self._sums: dict[float, list[Normal]] = {}

    def _equations(self, samples: Equilibria) -> Normal:
        return accumulate(
            samples, self._draft.frame, self._scale, self._settings.energy_degree_max, self._settings.weights
        )

    def anchor(self, choice: Choice, loads: np.ndarray) -> None:
        """Take the equilibria under ``loads`` of the energy ``choice``, each fold's of its own fit, as anchors."""
        self._low = [self.energy(choice, left_out) for left_out in (None, *range(self._settings.folds))]
        anchors = equilibria_of(replace(self._draft, energy=self._low[0]), loads)
        self._anchors = self._equations(anchors).matrix * (len(self._samples.load) / len(anchors.load))

    def energy(self, choice: Choice, left_out: int | None = None) -> np.ndarray:
        """Return the coefficients (monomials,) J of ``choice``, fitted to all samples but those of one fold."""
        matrix, right = self._seen(choice.image_weight)[0 if left_out is None else 1 + left_out]
        if choice.anchor_weight and self._anchors is not None:
            low = self._low[0 if left_out is None else 1 + left_out][self._draft.order + 1 :]
            matrix = matrix + choice.anchor_weight * self._anchors
            right = right + choice.anchor_weight * (self._anchors[:, : len(low)] @ low)
        return solve(Normal(matrix, right), self._draft.order, choice.degree, choice.ridge)

    def _seen(self, image_weight: float) -> list[Normal]:
        """Return the equations of all samples, then of all but those of each fold, with their images'."""
        if image_weight not in self._sums:
            parts = [
                Normal(*(a + image_weight * b for a, b in zip(own, images, strict=True)))
                for own, images in zip(self._own, self._images, strict=True)
            ] if image_weight and self._images else self._own  # fmt: skip
            whole = Normal(*(sum(part[k] for part in parts) for k in (0, 1)))
            self._sums[image_weight] = [whole, *(Normal(whole.matrix - p.matrix, whole.right - p.right) for p in parts)]
        return self._sums[image_weight]

    def judged(self, image_weight: float, anchor_weight: float, degree: int, ridge: float) -> Choice:
        """Return a choice with its error over folds that its fits did not see."""
        choice = Choice(image_weight, anchor_weight, degree, ridge, np.nan)
        farthest = LOST**2 * float((self._samples.coordinate[:, -3:] ** 2).sum(axis=1).mean())
        squares = 0.0
        for part in range(self._settings.folds):
            model = replace(self._draft, energy=self.energy(choice, part))
            errors = _squared_tip_errors(model, self._samples.rows(self._fold == part))
            squares += np.minimum(errors, farthest).sum()
        return choice._replace(tip_error_m=float(np.sqrt(squares / len(self._fold))))

    def model(self, choice: Choice) -> ReducedModel:
        """Return the reduced model with the energy ``choice``."""
        return replace(
            self._draft, energy=self.energy(choice), symmetry="all" if choice.image_weight else "none"
        )


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
    draft = replace(draft, **_fit_maps(settings, robot, samples, frame, fold))
    candidates = Candidates(settings, robot, draft, samples, fold)
    choices = _tried(settings, candidates)
    trial = trial_loads(robot, samples)
    trusted = _first_that_settles(candidates, choices, trial)
    if trusted is not None and trusted.degree < settings.energy_degree_max and any(settings.anchor_weights):
        candidates.anchor(trusted, anchor_loads(draft))
        choices += _anchored(settings, candidates, trusted)
        choices.sort(key=lambda choice: choice.tip_error_m)
        trusted = _first_that_settles(candidates, choices, trial)
    best = trusted or _safest(candidates, choices)
    if best is None:
        log.warning(
            "no energy fitted to %d equilibria is stable at rest; the reduced model is linear, from the compliance of "
            "the equilibrium nearest to rest: run stage=fem with more equilibria",
            len(samples.load),
        )
        model = replace(draft, energy=_linear_energy(samples, frame))
        errors = _squared_tip_errors(model, samples)
        best = Choice(0.0, 0.0, 2, 0.0, float(np.sqrt(errors.mean())))
    else:
        model = candidates.model(best)
    return model, [best, *(choice for choice in choices if choice != best)]


def tell_choice(model: ReducedModel, robot: Robot, samples: Equilibria, best: Choice) -> None:
    """Log what was chosen, and warn of wells."""
    if not _settles(model, trial_loads(robot, samples)):
        log.warning(
            "every energy has wells or saddles beyond its samples, in which a fast motion may be caught; the safest was "
            "taken: more equilibria, or a larger tip_force_scale of stage=fem, help"
        )
    log.info(
        "energy of degree %d, ridge %g, images of weight %g, anchors of weight %g: tip %.3f mm in cross-validation over "
        "%d equilibria",
        best.degree,
        best.ridge,
        best.image_weight,
        best.anchor_weight,
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


def _tried(settings: FitSettings, candidates: Candidates) -> list[Choice]:
    """Return the candidates without anchors by rising error of the tip in cross-validation.

    First all weights of images and degrees at the middle ridge, then the other ridges at the best weight, near its
    degree and the degree below.
    """
    ridges = sorted(settings.ridges)
    middle = ridges.pop(len(ridges) // 2)
    degrees = range(2, settings.energy_degree_max + 1)
    choices = [candidates.judged(weight, 0.0, degree, middle) for weight in candidates.image_weights for degree in degrees]
    best = min(choices, key=lambda choice: choice.tip_error_m)
    near = [degree for degree in degrees if abs(degree - best.degree) <= 1]
    choices += [candidates.judged(best.image_weight, 0.0, degree, ridge) for degree in near for ridge in ridges]
    return sorted(choices, key=lambda choice: choice.tip_error_m)


def _anchored(settings: FitSettings, candidates: Candidates, trusted: Choice) -> list[Choice]:
    """Return the candidates of higher degree than ``trusted``, held to it."""
    degrees = range(trusted.degree + 1, settings.energy_degree_max + 1)
    weights = [weight for weight in settings.anchor_weights if weight > 0.0]
    return [
        candidates.judged(image, anchor, degree, min(settings.ridges))
        for image in candidates.image_weights for degree in degrees for anchor in weights
    ]  # fmt: skip


def _first_that_settles(candidates: Candidates, choices: list[Choice], loads: np.ndarray) -> Choice | None:
    """Return the best of ``choices`` whose body is at rest only where it should be, or None.

    A polynomial may have further wells beyond the samples. Statics from rest does not find them; a motion falls in.
    """
    return next((choice for choice in choices if _settles(candidates.model(choice), loads)), None)


def _safest(candidates: Candidates, choices: list[Choice]) -> Choice | None:
    """Return, where none settles, the candidate of lowest degree above 2 and of most ridge that is stable at rest."""
    tame = sorted(choices, key=lambda choice: (choice.degree < 3, choice.degree, -choice.ridge, choice.tip_error_m))
    return next((choice for choice in tame if _stands(candidates.model(choice))), None)


def trial_loads(robot: Robot, samples: Equilibria) -> np.ndarray:
    """Return loads (S, r) under which a body with its weight must stand.

    They are those of the samples, tip forces no larger than the robot's limit, and pressures all over their range.
    """
    n = robot.chambers
    sampled = samples.load.copy()
    pull = np.linalg.norm(sampled[:, n:], axis=1, keepdims=True)
    sampled[:, n:] *= np.minimum(1.0, robot.tip_force_max_n / np.maximum(pull, 1e-12))
    pressures = np.zeros((PRESSURES, n + 3))
    span = robot.pressure_max_pa - robot.pressure_min_pa
    pressures[:, :n] = robot.pressure_min_pa + span * Sobol(n, seed=0).random(PRESSURES)
    return np.concatenate([sampled, pressures])


def anchor_loads(draft: ReducedModel) -> np.ndarray:
    """Return loads (ANCHORS, r) all over the pressures and a little beyond, and tip forces as large as samples' and weight.

    A moving body is not where its pressures alone would bring it: inertia loads it like weight does.
    """
    n = draft.chambers
    unit = Sobol(n + 3, seed=1).random(ANCHORS)
    middle = 0.5 * (draft.pressure_max_pa + draft.pressure_min_pa)
    half = 0.5 * BEYOND * (draft.pressure_max_pa - draft.pressure_min_pa)
    sink = gradient_of(draft.centre_of_mass, draft.order)[:, :, 0] @ draft.gravity_m_s2
    weight = draft.mass * sink @ np.linalg.inv(draft.frame)
    largest = np.abs([draft.load_low[n:], draft.load_high[n:]]).max() + np.linalg.norm(weight[n:])
    height, turn, radius = 2.0 * unit[:, n] - 1.0, 2.0 * np.pi * unit[:, n + 1], np.sqrt(unit[:, n + 2])
    flat = np.sqrt(1.0 - height**2)
    force = largest * radius[:, None] * np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return np.hstack([middle + half * (2.0 * unit[:, :n] - 1.0), force])


def equilibria_of(model: ReducedModel, loads: np.ndarray) -> Equilibria:
    """Return the stable equilibria of ``model`` without weight under ``loads`` (S, r), as far as they are found.

    They hold what the fit of an energy reads: coordinates, loads, energies, compliances and their slopes.
    """
    r, inverse = model.order, np.linalg.inv(model.frame)
    points, lost = static_points(tables_of(model, np.zeros(3)), loads)
    points = points[~lost & (np.linalg.norm(points, axis=1) <= 1.0)]
    table = basis(r, degree_of(r, len(model.energy)))
    slope, curve, third = table.gradient_rows(points), table.hessian_rows(points), table.third_rows(points)
    hessian = inverse.T @ (curve @ model.energy) @ inverse
    stable = np.linalg.eigvalsh(curve @ model.energy)[:, 0] > 0.0
    hessian, points = hessian[stable], points[stable]
    compliance = np.linalg.inv(hessian)
    moved = compliance @ inverse.T  # dy/dload
    bent = -np.einsum("sia,sjb,skc,sabc->sijk", moved, moved, moved, third[stable] @ model.energy, optimize=True)
    none = np.zeros((len(points), 0))
    return Equilibria(
        (slope[stable] @ model.energy) @ inverse, points @ model.frame.T, table.values(points) @ model.energy, compliance,
        bent, *(none for _ in range(7)),
    )


def _settles(model: ReducedModel, loads: np.ndarray) -> bool:
    """Return whether the body stands under each of ``loads`` (S, r), and comes to rest where statics says.

    It is thrown from load to load under its weight, well damped.
    """
    if not _stands(model):
        return False
    root = np.linalg.inv(np.linalg.cholesky(elastic_hessian_at_rest(model)))
    mass = model.mass_root[:, 0].reshape(model.order, model.order)
    slowest = 1.0 / np.sqrt(np.linalg.eigvalsh(root @ mass.T @ mass @ root.T)[-1])
    damped = replace(model, rayleigh_mass_per_s=max(model.rayleigh_mass_per_s, slowest))
    tables = tables_of(damped)
    points, lost = static_points(tables, loads)
    if lost.any() or _least_stiffness(tables, points) <= 0.0:
        return False
    held = np.repeat(loads, THROW_STEPS, axis=0)
    path = np.empty_like(held)
    failed, _ = run_kernel(*np.zeros((4, model.order)), THROW_STEP / slowest, held, tables, no_hooks(), path, *EMPTY)
    apart = np.linalg.norm(((path[THROW_STEPS - 1 :: THROW_STEPS] - points) @ model.frame.T)[:, -3:], axis=1)
    return failed == 0 and bool((apart < LOST * np.linalg.norm(points @ model.frame.T[:, -3:], axis=1).mean()).all())


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
