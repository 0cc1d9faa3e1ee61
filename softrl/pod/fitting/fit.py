"""From equilibria to a reduced model: degree, ridge and weight of symmetry are chosen by cross-validation.

Images of the samples under the robot's symmetries are further samples: in full where the body is symmetric, with less
weight where its mesh is lopsided, since where there are few samples their images still say how the body goes on.

A high degree follows the samples closely and may go astray between and beyond them, where weight and fast motion lead.
There it is held to the best energy of lower degree that stands everywhere: equilibria of that energy, under all
pressures and the tip forces that weight makes, are weak further samples, its *anchors*. Samples at corners of the pressures'
range are never left out: what a fit without one says of it tells nothing of the fit with it.
"""

import logging
from dataclasses import replace

import numpy as np

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE, ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError
from softrl.fem.sampling import at_corners
from softrl.pod.fitting.basis import PodBasis
from softrl.pod.fitting.candidates import (
    Candidates,
    Choice,
    anchored,
    best_first,
    first_that_settles,
    safest,
    squared_tip_errors,
    tried,
)
from softrl.pod.fitting.energy import frame_of
from softrl.pod.fitting.equilibria import Equilibria
from softrl.pod.fitting.map_fit import fit_maps
from softrl.pod.fitting.maps import ALWAYS
from softrl.pod.fitting.settings import FitSettings
from softrl.pod.fitting.settling import anchor_loads, settles, trial_loads
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
LINEAR = 0.0  # the ridge of a choice that is none: no energy that was fitted is stable at rest


def fit_model(
    settings: FitSettings,
    robot: Robot,
    snapshots: Snapshots,
    samples: Equilibria,
    pod: PodBasis,
    fold: np.ndarray,
) -> tuple[ReducedModel, list[Choice]]:
    """Return the reduced model of the equilibria ``samples``, and every energy that was tried, best first.

    ``fold`` (S,) says which of them are left out together, see ``folds_of``.
    """
    if len(samples.load) < settings.folds:
        raise ConfigError(
            f"{len(samples.load)} equilibria are too few for stage.folds={settings.folds}; run stage=fem with more"
        )
    frame = frame_of(samples)
    draft = _draft(robot, snapshots, samples, pod, frame)
    draft = replace(draft, **fit_maps(settings, robot, samples, frame, fold))
    candidates = Candidates(settings, robot, draft, samples, fold)
    choices = tried(settings, candidates)
    trial = trial_loads(robot, samples)
    trusted = first_that_settles(candidates, choices, trial)
    if trusted is not None and trusted.degree < settings.energy_degree_max and any(settings.anchor_weights):
        candidates.anchor(trusted, anchor_loads(draft))
        choices = best_first([*choices, *anchored(settings, candidates, trusted)])
        trusted = first_that_settles(candidates, choices, trial)
    best = trusted or first_that_settles(candidates, choices, trial, thrown=False) or safest(candidates, choices)
    if best is None:
        model = replace(draft, energy=_linear_energy(samples, frame))
        errors = squared_tip_errors(model, samples)
        best = Choice(0.0, 0.0, 2, LINEAR, float(np.sqrt(errors.mean())))
    else:
        model = candidates.model(best)
    return model, [best, *(choice for choice in choices if choice != best)]


def folds_of(samples: Equilibria, robot: Robot, folds: int, rng: np.random.Generator) -> np.ndarray:
    """Return the fold (S,) of each of ``samples``, ``ALWAYS`` for corners of the pressures' range, if enough others are left."""
    corner = at_corners(robot, samples.load)
    corner &= np.count_nonzero(~corner) >= folds
    fold = np.full(len(corner), ALWAYS)
    fold[~corner] = rng.permutation(np.arange(np.count_nonzero(~corner)) % folds)
    return fold


def tell_choice(model: ReducedModel, robot: Robot, samples: Equilibria, best: Choice) -> None:
    """Log what was chosen, and warn of wells, or of a body that had to be linear."""
    if best.ridge == LINEAR:
        log.warning(
            "no energy fitted to %d equilibria is stable at rest; the reduced model is linear, from the compliance of "
            "the equilibrium nearest to rest: smaller stage.ridges, or more equilibria of stage=fem, help",
            len(samples.load),
        )
    elif not settles(model, trial_loads(robot, samples), thrown=True):
        log.warning(
            "every energy has wells or saddles beyond its samples, in which a fast motion may be caught; the safest was "
            "taken: more equilibria, or a larger tip_force_scale of stage=fem, help"
        )
    log.info(
        "energy of degree %d, ridge %g, images of weight %g, anchors of weight %g: tip %.3f mm in cross-validation over "
        "%d equilibria, weighed by how far each is trusted",
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
        amplitudes=model.amplitudes[:, : 1 + r].copy(),
        stiffness_root=model.stiffness_root[:, :1].copy(),
        stiffness_root_by_gravity=model.stiffness_root_by_gravity[:, :1].copy(),
        centre_of_mass=model.centre_of_mass[:, : 1 + r].copy(),
        rotation=model.rotation[:, : 1 + r].copy(),
        give=model.give[:, :1].copy(),
        give_rotation=model.give_rotation[:, :1].copy(),
        inner_give=model.inner_give[:, :1].copy(),
        inner_rotation=model.inner_rotation[:, :1].copy(),
        inner_root=model.inner_root[:, :1].copy(),
        drag_root=model.drag_root[:, :1].copy(),
        layer_energy=model.layer_energy[:, :few].copy(),
        layer_give=model.layer_give[:, :few].copy(),
        layer_drop=model.layer_drop[:, : 1 + r].copy(),
        layer_spin=model.layer_spin[:, : 1 + r].copy(),
    )


def _draft(robot: Robot, snapshots: Snapshots, samples: Equilibria, pod: PodBasis, frame: np.ndarray) -> ReducedModel:
    """Return the model before its maps are fitted."""
    r, layers = len(frame), snapshots.layer_energy.shape[1]
    pairs = r * (r + 1) // 2
    return ReducedModel(
        frame=frame,
        energy=np.zeros(1 + r),
        amplitudes=np.eye(r, 1 + r, 1),
        stiffness_root=np.zeros((pairs, 1)),
        stiffness_factor=np.eye(r),
        stiffness_root_by_gravity=np.zeros((3 * pairs, 1)),
        centre_of_mass=np.zeros((3, 1 + r)),
        rotation=np.zeros((3, 1)),
        give=np.zeros((9, 1)),
        give_rotation=np.zeros((9, 1)),
        inner_give=np.zeros((TRIANGLE, 1)),
        inner_rotation=np.zeros((3 * SHAPES, 1)),
        inner_root=np.zeros((SHAPES * r + TRIANGLE, 1)),
        drag_root=np.zeros((SHAPES * r + TRIANGLE, 1)),
        layer_energy=np.zeros((layers, 1)),
        layer_give=np.zeros((layers * (layers + 1) // 2, 1)),
        layer_drop=np.zeros((3 * layers, 1)),
        layer_spin=np.zeros((3 * layers, 1)),
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


def _linear_energy(samples: Equilibria, frame: np.ndarray) -> np.ndarray:
    """Return the coefficients (monomials,) J of half y' H y with H from the equilibrium nearest to rest."""
    r = len(frame)
    nearest = int(np.argmin(np.linalg.norm(np.linalg.solve(frame, samples.coordinate.T), axis=0)))
    hessian = frame.T @ np.linalg.inv(samples.compliance[nearest]) @ frame
    rows, columns = np.triu_indices(r)
    return np.r_[np.zeros(r + 1), hessian[rows, columns] * np.where(rows == columns, 0.5, 1.0)]
