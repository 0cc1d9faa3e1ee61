"""pod: from snapshots of the full model to a reduced one."""

import logging
from dataclasses import dataclass

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.parallel import LOCAL, Parallel
from softrl.core.threads import one_thread
from softrl.core.tracking import Tracker
from softrl.fem.sampling import at_corners
from softrl.pod.convergence import by_equilibria, report_coordinates, report_equilibria
from softrl.pod.figures import draw_choice, draw_convergence, draw_motion, draw_parity, draw_spectrum
from softrl.pod.fitting.basis import PodBasis, pod_basis, projection_errors
from softrl.pod.fitting.equilibria import equilibria
from softrl.pod.fitting.fit import fit_model, folds_of, linear_model, tell_choice
from softrl.pod.fitting.map_fit import tell_symmetry
from softrl.pod.fitting.settings import FitSettings
from softrl.pod.report import report_motions, report_speed, report_statics, report_weight, statics
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Config(FitSettings):
    """POD modes and the energy ROM: judged by the fit without the held-out equilibria, then fitted to all.

    Attributes
    ----------
    FitSettings : how the ROM is fitted
    pod_energy : keep modes until this share of the squared singular values;  modes_max : at most this many
    heldout_share : share of the equilibria that no fit and no choice sees until they have judged
    convergence_shares : of the seen equilibria, to which the model is fitted once more for the convergence figure
    processes : of this machine that fit
    """

    pod_energy: float
    modes_max: int
    heldout_share: float
    convergence_shares: tuple[float, ...]
    processes: int
    seed: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.pod_energy <= 1.0:
            raise ConfigError(f"stage.pod_energy={self.pod_energy:g}; expected a share in (0, 1]")
        for name in ("modes_max", "processes"):
            if getattr(self, name) < 1:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be at least 1")
        if not 0.0 < self.heldout_share < 0.9:
            raise ConfigError(f"stage.heldout_share={self.heldout_share:g}; expected a share between 0 and 0.9")
        if not all(0.0 < share <= 1.0 for share in self.convergence_shares):
            raise ConfigError(f"stage.convergence_shares={self.convergence_shares}; expected shares in (0, 1]")


def run(
    config: Config, robot: Robot, snapshots: Snapshots, parallel: Parallel | None = None, *, tracker: Tracker
) -> ReducedModel:
    """Return the reduced model of the body that ``snapshots`` show.

    The fit that is judged and the fit to all equilibria are two tasks: neither needs the other.
    """
    robot.check_upright("stage=pod")
    _refuse_other(robot, snapshots)
    with one_thread():
        return _reduced(config, robot, snapshots, parallel or LOCAL, tracker)


def _reduced(
    config: Config, robot: Robot, snapshots: Snapshots, parallel: Parallel, tracker: Tracker
) -> ReducedModel:
    rng = np.random.default_rng(config.seed)
    seen, heldout = _split(config, at_corners(robot, snapshots.loads), rng)
    pod = pod_basis(snapshots.displacement[seen], snapshots.nodal_mass, config.pod_energy, config.modes_max)
    _report_pod(pod, snapshots, seen, heldout, tracker)
    samples = equilibria(snapshots)
    parts = [samples.rows(seen), samples]
    tasks = [(config, robot, snapshots, part, pod, folds_of(part, robot, config.folds, rng)) for part in parts]
    fits = dict(parallel.map(fit_model, tasks, config.processes))
    (model, choices), (whole, whole_choices) = fits[0], fits[1]
    tell_symmetry(robot, samples, whole.frame)
    tell_choice(model, robot, samples.rows(seen), choices[0])
    tracker.metric("energy_degree", choices[0].degree)
    tracker.metric("image_weight", choices[0].image_weight)
    tracker.metric("anchor_weight", choices[0].anchor_weight)
    tracker.metric("validation/static_tip_weighed_rms_mm", 1e3 * choices[0].tip_error_m)
    tracker.figure("energy_choice", draw_choice(choices))
    linear = linear_model(model)
    report_statics(model, linear, samples.rows(seen), "train", tracker)
    static = report_statics(model, linear, samples.rows(heldout), "heldout", tracker)
    tracker.figure("static_parity", draw_parity(static, statics(linear, samples.rows(heldout))[0]))
    report_coordinates(model, snapshots, samples.rows(heldout), tracker)
    sides = samples.rows(seen), samples.rows(heldout)
    points = by_equilibria(config.convergence_shares, config, choices[0], robot, snapshots, sides, pod, model)
    report_equilibria(points, tracker)
    tracker.figure("convergence", draw_convergence(choices, points))
    tell_choice(whole, robot, samples, whole_choices[0])  # those held out have judged how it is done
    if len(snapshots.trajectory_load):
        moving = report_motions(whole, linear_model(whole), snapshots, tracker)
        tracker.figure("motion", draw_motion(snapshots.trajectory_time, moving, 0))
    report_speed(whole, snapshots, rng, tracker)
    report_weight(whole, tracker)
    return whole


def _refuse_other(robot: Robot, snapshots: Snapshots) -> None:
    if snapshots.chambers != robot.chambers:
        raise ArtifactError(
            f"the Snapshots of {snapshots.robot_name} have {snapshots.chambers} chambers, robot {robot.name} has "
            f"{robot.chambers}; run stage=fem for this robot"
        )


def _split(config: Config, corner: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the row numbers that are seen, and those held out, a ``corner`` (S,) of the pressures' range last of all."""
    order = rng.permutation(len(corner))
    order = order[np.argsort(corner[order], kind="stable")]
    held = max(1, round(config.heldout_share * len(corner)))
    return np.sort(order[held:]), np.sort(order[:held])


def _report_pod(pod: PodBasis, snapshots: Snapshots, seen: np.ndarray, heldout: np.ndarray, tracker: Tracker) -> None:
    """Log the modes and how far snapshots are from their span; that error is no evidence for a motion's error."""
    errors = {
        name: projection_errors(pod, snapshots.displacement[rows], snapshots.nodal_mass)
        for name, rows in (("train", seen), ("heldout", heldout))
    }
    tracker.metric("pod_modes", len(pod.modes))
    for name, error in errors.items():
        tracker.metric(f"{name}/pod_projection_rms_mm", 1e3 * float(error[-1]))
        tracker.metric(f"{name}/baseline_no_modes_rms_mm", 1e3 * float(error[0]))
    tracker.figure(
        "pod_spectrum", draw_spectrum(pod.singular_values, len(pod.modes), errors["train"], errors["heldout"])
    )
