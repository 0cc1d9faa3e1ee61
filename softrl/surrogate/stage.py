"""Rigid-link surrogate of the soft robot: links from the mesh, joints from the body's statics, f_SP and its inverse."""

import logging
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.mesh import Mesh
from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError, SolverError
from softrl.core.scaling import Scaler
from softrl.core.tracking import Tracker
from softrl.pod.rom import static_coordinates, tip_poses
from softrl.robots.robot import Robot
from softrl.surrogate.dimensions import Dimensions, dimensions_of
from softrl.surrogate.fit import fit_joints
from softrl.surrogate.full_model import report_yielding, sampled_yielding
from softrl.surrogate.kinematics import Chain, chain_from
from softrl.surrogate.mlp import train_network
from softrl.surrogate.motion import report_motion
from softrl.surrogate.report import Judged, report, report_full_model, report_workspace
from softrl.surrogate.springs import Springs, softness_at
from softrl.surrogate.stiffness import Couple, Poses, Statics, fit_springs, told_compliance
from softrl.surrogate.twin import Twin
from softrl.surrogate.urdf import write_urdf

log = logging.getLogger(__name__)
SAMPLED_RADIUS = 0.97  # of the ball that holds the reduced model's samples; beyond it extrapolates, and yields less
WORST_FIT = 0.1  # of the tips' spread: a chain that cannot follow the body is no surrogate of it
STILL_SHARE = 1e-3  # of what the joint that moves the tip most does: a joint that does less has no range
JOINTS = ("theta_x", "theta_y", "d")


@dataclass(frozen=True)
class Config:
    """Surrogate of one robot.

    Attributes
    ----------
    links : planar links of equal length where the mesh shows no ribs
    samples : equilibria under Sobol pressures, of which ``heldout_share`` are kept from training
    bend_max_rad : the fit searches joint commands whose bend over the whole chain is below this
    slide_max_share : and whose slide in a gap is below this share of the mean pitch
    limit_margin_share : joint limits lie this share of the range of motion beyond it
    compliance_samples : pressures at which the body's compliance is taken, every second one held out
    compliance_force_n : force of the differences, a small part of what the robot's tip is made for
    spring_iterations, spring_ridge : fit of the springs to them: iterations, and weight that keeps them alike over poses
    hidden, iterations : width of the networks, iterations of their training
    tip_radius_m : sphere with which the tip touches surfaces
    contact_stiffness_n_per_m, contact_damping_n_s_per_m : of that touch
    compared_fits : samples that L-BFGS-B fits too, for comparison;  parity_samples : commands that PyBullet repeats
    full_checks : pressures besides rest at which the full model is solved anew, to judge the stiffness by
    """

    links: int
    samples: int
    heldout_share: float
    bend_max_rad: float
    slide_max_share: float
    limit_margin_share: float
    compliance_samples: int
    compliance_force_n: float
    spring_iterations: int
    spring_ridge: float
    hidden: int
    iterations: int
    tip_radius_m: float
    contact_stiffness_n_per_m: float
    contact_damping_n_s_per_m: float
    compared_fits: int
    parity_samples: int
    full_checks: int
    seed: int

    def __post_init__(self) -> None:
        positive = ("links", "samples", "bend_max_rad", "slide_max_share", "compliance_force_n", "hidden", "iterations",
                    "tip_radius_m", "contact_stiffness_n_per_m", "compared_fits", "parity_samples", "spring_iterations",
                    "spring_ridge")  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        for name in ("limit_margin_share", "contact_damping_n_s_per_m", "full_checks"):
            if getattr(self, name) < 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must not be negative")
        if not 0.0 < self.heldout_share < 1.0:
            raise ConfigError(f"stage.heldout_share={self.heldout_share:g}; expected a share between 0 and 1")
        if self.compliance_samples < 2:
            raise ConfigError(
                f"stage.compliance_samples={self.compliance_samples}; expected 2 or more, half are held out"
            )
        if not self.bend_max_rad < np.pi:
            raise ConfigError(f"stage.bend_max_rad={self.bend_max_rad:g}; expected less than half a turn, 3.14")


class Samples(NamedTuple):
    """Equilibria: pressure (S, n) Pa and poses; fitted joints (S, 3), residual (S,) m, held-out rows (S,) bool."""

    pressure: np.ndarray
    tip: np.ndarray
    quaternion: np.ndarray | None
    sampled: np.ndarray
    joints: np.ndarray
    residual: np.ndarray
    heldout: np.ndarray


def run(
    config: Config,
    robot: Robot,
    mesh: Mesh | None,
    reduced_model: ReducedModel,
    snapshots: Snapshots,
    calibration: Calibration | None = None,
    *,
    tracker: Tracker,
) -> Surrogate:
    """Return the surrogate fitted to the reduced model's equilibria, judged against the full model's under loads too.

    What a moment turns at rest is the full model's own, where its mesh is there; its stiffness elsewhere judges only. Where
    a calibration is there, the tips at which the robot settled are laid over the workspace.
    """
    full = None if mesh is None else sampled_yielding(robot, mesh, snapshots, config.full_checks, config.seed)
    hanging = partial(model_poses, reduced_model, gravity_m_s2=np.array(robot.gravity_m_s2))
    surrogate = build_surrogate(
        config, robot, mesh, hanging, float(reduced_model.rest_tip[2]), tracker,
        None if full is None else full.yields[0, 3:, 3:],
        (snapshots.rayleigh_mass_per_s, snapshots.rayleigh_stiffness_s),
    )  # fmt: skip
    report_motion(surrogate, robot, reduced_model, tracker)
    if full is not None:
        report_yielding(surrogate, full, robot.tip_force_max_n, tracker)
    # the full model's equilibria are without weight: the chain that is compared with them is one without as well
    weightless = partial(model_poses, reduced_model, gravity_m_s2=np.zeros(3))
    report_full_model(
        _refitted(config, surrogate, weightless), snapshots, weightless, robot.tip_force_max_n, tracker
    )
    none = np.empty((0, 3))
    report_workspace(
        surrogate, none if full is None else full.tip, none if calibration is None else calibration.settled_tip, tracker
    )
    return surrogate


def _refitted(config: Config, surrogate: Surrogate, pose_of: Statics) -> Surrogate:
    """Return the surrogate with the springs of another body, fitted at as many of its pressures."""
    pressure = surrogate.sample_pressure[~surrogate.heldout][: config.compliance_samples]
    free = pose_of(np.hstack([pressure, np.zeros((len(pressure), 3))]))
    known = np.ones(len(pressure), dtype=bool) if free.sampled is None else free.sampled
    twin = Twin(surrogate)
    told, compliance = told_compliance(pose_of, pressure[known], config.compliance_force_n)
    springs = fit_springs(
        twin.joints_for_tip(free.tip[known][told]), twin.chain, compliance, surrogate.joint_low, surrogate.joint_high,
        config.spring_iterations, config.spring_ridge,
    )  # fmt: skip
    return replace(surrogate, softness_coefficients=springs.coefficients, gap_share=springs.share)


def model_poses(reduced_model: ReducedModel, loads: np.ndarray, gravity_m_s2: np.ndarray | None = None) -> Poses:
    """Return the poses of the reduced model at equilibrium under ``loads`` (S, n + 3) Pa and N."""
    z = static_coordinates(reduced_model, loads, gravity_m_s2)
    radius = np.linalg.norm(np.linalg.solve(reduced_model.frame, z.T), axis=0)
    return Poses(*tip_poses(reduced_model, z, gravity_m_s2), radius < SAMPLED_RADIUS)


def build_surrogate(
    config: Config, robot: Robot, mesh: Mesh | None, pose_of: Statics, tip_height: float, tracker: Tracker,
    rest_turn: np.ndarray | None = None, rayleigh: tuple[float, float] = (0.0, 0.0),
) -> Surrogate:  # fmt: skip
    """Return the surrogate of any body that ``pose_of`` describes.

    ``rest_turn`` (3, 3) rad per N m is what moments on the tip turn at rest, where that is known; ``rayleigh`` is the body's
    damping by its inertia, 1/s, and by its stiffness, s.
    """
    if config.compliance_force_n > robot.tip_force_max_n:
        raise ConfigError(
            f"stage.compliance_force_n={config.compliance_force_n:g} is more than the tip of {robot.name} is made for, "
            f"robot.tip_force_max_n={robot.tip_force_max_n:g}; expected a small part of it, as 0.05 times"
        )
    rng = np.random.default_rng(config.seed)
    dimensions = dimensions_of(robot, mesh, tip_height, config.links)
    chain = chain_from(dimensions.joint_height, dimensions.plane_height, dimensions.tip_height)
    samples = _sample(config, robot, dimensions, chain, pose_of, rng)
    low, high = _limits(config, robot, dimensions, samples)
    springs, judged = _springs(config, samples, chain, pose_of, low, high, rest_turn)
    surrogate = _assemble(config, robot, dimensions, samples, springs, rayleigh)
    return report(surrogate, judged, config.compared_fits, config.parity_samples, robot.tip_force_max_n, tracker)


def _sample(
    config: Config, robot: Robot, dimensions: Dimensions, chain: Chain, pose_of: Statics, rng: np.random.Generator
) -> Samples:
    sobol = qmc.Sobol(robot.chambers, rng=rng).random_base2(int(np.ceil(np.log2(config.samples))))[: config.samples]
    pressure = robot.pressure_min_pa + sobol * (robot.pressure_max_pa - robot.pressure_min_pa)
    started = time.perf_counter()
    tip, quaternion, sampled = pose_of(np.hstack([pressure, np.zeros((len(pressure), 3))]))
    found = np.isfinite(tip).all(axis=1)
    if found.mean() < 0.95:
        raise SolverError(f"{(~found).sum()} of {len(found)} sampled equilibria were not found; expected 5 % at most")
    pressure, tip, quaternion = pressure[found], tip[found], None if quaternion is None else quaternion[found]
    sampled = np.ones(len(tip), dtype=bool) if sampled is None else sampled[found]
    gaps = len(dimensions.plane_height)
    bend, slide = (
        config.bend_max_rad / gaps,
        config.slide_max_share * float(np.diff(dimensions.plane_height, prepend=0).mean()),
    )
    limit = np.array([bend, bend, slide])
    fit = fit_joints(chain, tip, -limit, limit)
    left, spread = np.sqrt(np.mean(fit.residual**2)), np.sqrt(np.mean((tip - tip.mean(axis=0)) ** 2) * 3)
    if left > WORST_FIT * spread:
        raise SolverError(
            f"the joints reach the body's tips to {1e3 * left:.2g} mm rms only, where these spread by {1e3 * spread:.2g} mm: "
            f"stage.bend_max_rad={config.bend_max_rad:g} or stage.slide_max_share={config.slide_max_share:g} is too small"
        )
    if not sampled.all():
        log.info(
            "%d equilibria lie outside the reduced model's samples; springs are not fitted there", (~sampled).sum()
        )
    log.info(
        "%d equilibria, fitted to %.2g mm rms in %.1f s", len(tip), 1e3 * np.sqrt(np.mean(fit.residual**2)),
        time.perf_counter() - started,
    )  # fmt: skip
    heldout = np.zeros(len(tip), dtype=bool)
    heldout[rng.permutation(len(tip))[: max(1, round(config.heldout_share * len(tip)))]] = True
    if (~heldout).sum() < 2:
        raise ConfigError(
            f"stage.samples={config.samples} with heldout_share={config.heldout_share:g} leaves {(~heldout).sum()} to fit; "
            "expected 2 or more"
        )
    return Samples(pressure, tip, quaternion, sampled, fit.theta, fit.residual, heldout)


def _limits(config: Config, robot: Robot, dimensions: Dimensions, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return the range of motion (3,) of the grouped command, with its margin; the chain's rest at zero is in it."""
    low, high = samples.joints.min(axis=0), samples.joints.max(axis=0)
    _check_moves(robot, dimensions, high - low)
    margin = config.limit_margin_share * (high - low)
    return np.minimum(low - margin, 0.0), np.maximum(high + margin, 0.0)


def _check_moves(robot: Robot, dimensions: Dimensions, span: np.ndarray) -> None:
    """Refuse a joint without a ``span`` (3,) rad, rad, m: commands are told as shares of it, and springs are fitted over it."""
    half = 0.5 * dimensions.tip_height
    moves = len(dimensions.plane_height) * span * [half, half, 1.0]  # m, about what each takes the tip along
    still = np.flatnonzero(~(moves > STILL_SHARE * moves.max()))
    if len(still):
        names = " and ".join(JOINTS[i] for i in still)
        raise ConfigError(
            f"robot {robot.name}: over its pressures joint {names} moves the tip by {1e3 * moves[still].max():.2g} mm, the "
            f"others by up to {1e3 * moves.max():.3g} mm; surrogate, rl and sim2real need a tip that moves in three directions, "
            "as by three chambers around the backbone; the other stages do without"
        )


def _springs(
    config: Config, samples: Samples, chain: Chain, pose_of: Statics, low: np.ndarray, high: np.ndarray,
    rest_turn: np.ndarray | None,
) -> tuple[Springs, Judged]:  # fmt: skip
    """Return the joints' springs, and what they are to be judged by: the body at the held-out pressures."""
    known = np.flatnonzero(samples.sampled)
    if len(known) < 2:
        raise SolverError(
            f"{len(known)} of {len(samples.tip)} equilibria lie among the reduced model's samples; expected 2 or more: "
            "its samples do not cover the robot's pressures, rerun stage=fem and stage=pod"
        )
    chosen = known[np.linspace(0, len(known) - 1, min(config.compliance_samples, len(known))).astype(int)]
    told, compliance = told_compliance(pose_of, samples.pressure[chosen], config.compliance_force_n)
    joints, fitted, judging = samples.joints[chosen][told], slice(0, None, 2), slice(1, None, 2)
    fit = partial(
        fit_springs, joints[fitted], chain, compliance.where(fitted), low, high, config.spring_iterations,
        config.spring_ridge,
    )  # fmt: skip
    couple = None
    if rest_turn is not None:
        rest_tip = pose_of(np.zeros((1, samples.pressure.shape[1] + 3))).tip
        couple = Couple(fit_joints(chain, rest_tip, low, high).theta[0], rest_turn)
    judged = Judged(samples.residual, samples.quaternion, joints[judging], compliance.where(judging), fit(alike=True))
    return fit(couple=couple), judged


def _assemble(
    config: Config, robot: Robot, dimensions: Dimensions, samples: Samples, springs: Springs, rayleigh: tuple[float, float]
) -> Surrogate:
    seen, low, high = ~samples.heldout, springs.low, springs.high
    pressures, joints = Scaler.fit(samples.pressure[seen]), Scaler.fit(samples.joints[seen])
    x, y = pressures.scale(samples.pressure[seen]), joints.scale(samples.joints[seen])
    # a single joint yields to loads beyond the range of the grouped command
    play = 0.5 * (high - low)
    return Surrogate(
        urdf=write_urdf(robot.name, dimensions, robot.mass_kg, low - play, high + play, config.tip_radius_m),
        joint_height=dimensions.joint_height,
        plane_height=dimensions.plane_height,
        plane_radius=dimensions.plane_radius,
        neck_radius=dimensions.neck_radius,
        tip_height=dimensions.tip_height,
        joint_low=low,
        joint_high=high,
        joint_stiffness=1.0 / np.diag(softness_at(samples.joints[_at_rest(samples)], springs)),
        contact_stiffness_n_per_m=config.contact_stiffness_n_per_m,
        contact_damping_n_s_per_m=config.contact_damping_n_s_per_m,
        mass=robot.mass_kg,
        gravity_m_s2=robot.gravity_m_s2,
        rayleigh_mass_per_s=rayleigh[0],
        rayleigh_stiffness_s=rayleigh[1],
        sample_pressure=samples.pressure,
        sample_tip=samples.tip,
        sample_joints=samples.joints,
        heldout=samples.heldout,
        forward=train_network(x, y, config.hidden, config.iterations, config.seed),
        inverse=train_network(y, x, config.hidden, config.iterations, config.seed + 1),
        pressure_mean=pressures.mean,
        pressure_spread=pressures.spread,
        joint_mean=joints.mean,
        joint_spread=joints.spread,
        pressure_low=samples.pressure.min(axis=0),
        pressure_high=samples.pressure.max(axis=0),
        metrics={},
        robot_name=robot.name,
        softness_coefficients=springs.coefficients,
        gap_share=springs.share,
    )


def _at_rest(samples: Samples) -> int:
    """Return the sample of the smallest pressures."""
    return int(np.argmin((samples.pressure**2).sum(axis=1)))
