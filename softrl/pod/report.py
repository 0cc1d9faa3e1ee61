"""How good a reduced model is on data it has not seen: statics, motion, orientation, speed."""

import time
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.polynomial import basis, degree_of
from softrl.core.tracking import Tracker
from softrl.pod.fitting.equilibria import Equilibria, rotation_vector
from softrl.pod.rom import NO_HOOKS, STILL, roll_poses, static_coordinates, static_points, tip_poses
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.tables import tables_of

NO_WEIGHT = np.zeros(3)  # the equilibria are without weight
SPEED_STEPS = 20_000


class Prediction(NamedTuple):
    """Coordinates (..., n + 3) m^3 and m beside the full model's; in motion, the predicted orientations (..., 4) too."""

    predicted: np.ndarray
    full: np.ndarray
    quaternion: np.ndarray | None = None

    def tip_errors(self) -> np.ndarray:
        """Return the tip's distances (...,) m."""
        return np.linalg.norm((self.predicted - self.full)[..., -3:], axis=-1)

    def volume_error(self) -> float:
        """Return the rms volume error over the rms volume change."""
        change = self.full[..., :-3]
        return float(np.sqrt(((self.predicted[..., :-3] - change) ** 2).mean() / (change**2).mean()))


def statics(model: ReducedModel, samples: Equilibria) -> tuple[Prediction, int]:
    """Return the model's equilibria under the samples' loads, and how many were not found; those stay at rest."""
    points, failed = static_points(tables_of(model, NO_WEIGHT), samples.load)
    found = np.where(failed[:, None], 0.0, points) @ model.frame.T
    return Prediction(found, samples.coordinate), int(failed.sum())


def motions(model: ReducedModel, snapshots: Snapshots) -> Prediction:
    """Return the model's trajectories under loads and weight of the full model's, from rest."""
    gravity, load = snapshots.trajectory_gravity_m_s2, snapshots.trajectory_load
    rest = static_coordinates(model, np.zeros((1, model.order)), gravity)
    rolled = roll_poses(model, _time_step(snapshots), load, np.repeat(rest, len(load), axis=0), gravity_m_s2=gravity)
    return Prediction(rolled.coordinate, snapshots.trajectory_coordinate, rolled.quaternion)


def report_statics(
    model: ReducedModel, linear: ReducedModel, samples: Equilibria, split: str, tracker: Tracker
) -> Prediction:
    """Log the static errors on ``samples`` with those of the linearised model; return the prediction."""
    prediction, failed = statics(model, samples)
    baseline, _ = statics(linear, samples)
    errors = prediction.tip_errors()
    tracker.metric(f"{split}/static_tip_rms_mm", 1e3 * rms(errors))
    tracker.metric(f"{split}/static_tip_max_mm", 1e3 * float(errors.max()))
    tracker.metric(f"{split}/static_volume_error_percent", 100.0 * prediction.volume_error())
    tracker.metric(f"{split}/static_orientation_deg", np.rad2deg(rms(orientation_errors(model, samples))))
    tracker.metric(f"{split}/static_failed", failed)
    tracker.metric(f"{split}/mass_error_percent", 100.0 * rms(mass_errors(model, samples)))
    tracker.metric(f"{split}/baseline_linear_static_tip_rms_mm", 1e3 * rms(baseline.tip_errors()))
    tracker.metric(f"{split}/motion_tip_rms_mm", 1e3 * rms(np.linalg.norm(samples.coordinate[:, -3:], axis=1)))
    return prediction


def mass_errors(model: ReducedModel, samples: Equilibria) -> np.ndarray:
    """Return the relative errors (S, n + 3) of the kinetic energy as each load changes, all of it at the samples."""
    r, rate = model.order, np.linalg.solve(model.frame, samples.compliance)
    points = np.linalg.solve(model.frame, samples.coordinate.T).T
    table = basis(r, degree_of(r, model.amplitudes.shape[1]))
    moved = np.einsum("srm,km,srl->skl", table.gradient_rows(points), model.amplitudes, rate, optimize=True)
    full = np.einsum("sil,sij,sjl->sl", samples.compliance, samples.answers["mass"], samples.compliance, optimize=True)
    return np.asarray((moved**2).sum(axis=1) / full - 1.0)


def report_motions(model: ReducedModel, linear: ReducedModel, snapshots: Snapshots, tracker: Tracker) -> Prediction:
    """Log the errors along the full model's trajectories, which no fit has seen, beside two baselines.

    The baselines are the linearised model, and the equilibrium under each load at once (no inertia, no damping).
    """
    moving = motions(model, snapshots)
    errors = moving.tip_errors()
    tracker.metric("heldout/dynamic_tip_rms_mm", 1e3 * rms(errors))
    tracker.metric("heldout/dynamic_tip_max_mm", 1e3 * float(errors.max()))
    tracker.metric("heldout/dynamic_volume_error_percent", 100.0 * moving.volume_error())
    tracker.metric("heldout/dynamic_motion_tip_rms_mm", 1e3 * rms(np.linalg.norm(moving.full[..., -3:], axis=-1)))
    tracker.metric("heldout/baseline_linear_dynamic_tip_rms_mm", 1e3 * rms(motions(linear, snapshots).tip_errors()))
    flat = snapshots.trajectory_load.reshape(-1, model.order)
    unique, where = np.unique(flat, axis=0, return_inverse=True)
    tables = tables_of(model, snapshots.trajectory_gravity_m_s2)
    still = static_points(tables, unique)[0][where.ravel()] @ model.frame.T
    static = Prediction(still.reshape(moving.full.shape), moving.full)
    tracker.metric("heldout/baseline_static_dynamic_tip_rms_mm", 1e3 * rms(static.tip_errors()))
    turned = rotation_vector(snapshots.trajectory_quaternion.reshape(-1, 4))
    assert moving.quaternion is not None
    angle = relative_angle(moving.quaternion.reshape(-1, 4), turned)
    tracker.metric("heldout/dynamic_orientation_deg", np.rad2deg(rms(angle)))
    return moving


def report_speed(model: ReducedModel, snapshots: Snapshots, rng: np.random.Generator, tracker: Tracker) -> None:
    """Log the steps per second on one core under random steps of pressure, poses included, and how far they reach."""
    tables, r = tables_of(model), model.order
    level = rng.uniform(0.0, 1.0, (SPEED_STEPS // 50, model.chambers))
    load = np.zeros((SPEED_STEPS, r))
    load[:, : model.chambers] = np.repeat(
        model.pressure_min_pa + (model.pressure_max_pa - model.pressure_min_pa) * level, 50, axis=0
    )
    position, quaternion = np.empty((SPEED_STEPS, 3)), np.empty((SPEED_STEPS, 4))
    run = (tables, NO_HOOKS, np.empty((0, r)), position, quaternion)
    dt = _time_step(snapshots)
    still = [*np.zeros((2, r)), STILL, np.zeros(r)]
    run_kernel(*(part.copy() for part in still), dt, load[:1], *run[:3], position[:1], quaternion[:1])
    moving = [part.copy() for part in still]
    began = time.process_time()
    failed, farthest, _ = run_kernel(*moving, dt, load, *run)
    tracker.metric("rom_steps_per_s", SPEED_STEPS / (time.process_time() - began))
    tracker.metric("rom_steps_failed", failed)
    tracker.metric("reach_of_samples", farthest)


def report_weight(model: ReducedModel, tracker: Tracker) -> None:
    """Log the sag under weight, and the tip force that would load the tip like it over the largest sampled one."""
    n = model.chambers
    points, _ = static_points(tables_of(model), np.zeros((1, model.order)))
    z = model.frame @ points[0]
    tables = tables_of(model)
    pull = model.gravity_m_s2 @ tables.weight[:, :, 0] @ tables.inverse  # load (n + 3,) of weight at rest
    sampled = np.abs(np.r_[model.load_low[n:], model.load_high[n:]]).max()
    tracker.metric("weight/sag_tip_mm", 1e3 * float(np.linalg.norm(z[n:])))
    tracker.metric("weight/tip_force_over_sampled", float(np.linalg.norm(pull[n:]) / max(sampled, 1e-9)))


def orientation_errors(model: ReducedModel, samples: Equilibria) -> np.ndarray:
    """Return the angles (S,) rad between the model's and the full model's plate at the samples' own coordinates."""
    return relative_angle(tip_poses(model, samples.coordinate, NO_WEIGHT)[1], samples.answers["rotation"])


def relative_angle(quaternion: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return the angles (S,) rad between orientations given as w x y z (S, 4) and as rotation vectors (S, 3)."""
    half = 0.5 * np.linalg.norm(rotation, axis=1, keepdims=True)
    other = np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotation])
    apart = np.linalg.norm(quaternion * np.sign((quaternion * other).sum(axis=1, keepdims=True)) - other, axis=1)
    return 4.0 * np.arcsin(np.minimum(0.5 * apart, 1.0))


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt((values**2).mean()))


def _time_step(snapshots: Snapshots) -> float:
    time_s = snapshots.trajectory_time
    return float(time_s[1] - time_s[0]) if len(time_s) > 1 else 0.01
