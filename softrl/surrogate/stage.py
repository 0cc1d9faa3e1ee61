"""Rigid-link surrogate of the soft robot: links from the mesh, joints from the body's statics, f_SP and its inverse."""

import logging
import time
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import qmc

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError, SolverError
from softrl.core.scaling import Scaler
from softrl.core.tracking import Tracker
from softrl.pod.rom import static_coordinates
from softrl.robots.robot import Robot
from softrl.surrogate.dimensions import Dimensions, dimensions_of
from softrl.surrogate.fit import fit_joints
from softrl.surrogate.kinematics import Chain, chain_from
from softrl.surrogate.mlp import train_network
from softrl.surrogate.report import report
from softrl.surrogate.stiffness import Statics, body_compliance, fit_joint_stiffness
from softrl.surrogate.urdf import write_urdf

log = logging.getLogger(__name__)


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
    compliance_samples : pressures at which the tip's compliance is taken, every second one held out
    compliance_force_n : force of the differences
    hidden, iterations : width of the networks, iterations of their training
    tip_radius_m : sphere with which the tip touches surfaces
    contact_stiffness_n_per_m, contact_damping_n_s_per_m : of that touch
    compared_fits : samples that L-BFGS-B fits too, for comparison;  parity_samples : commands that PyBullet repeats
    """

    links: int
    samples: int
    heldout_share: float
    bend_max_rad: float
    slide_max_share: float
    limit_margin_share: float
    compliance_samples: int
    compliance_force_n: float
    hidden: int
    iterations: int
    tip_radius_m: float
    contact_stiffness_n_per_m: float
    contact_damping_n_s_per_m: float
    compared_fits: int
    parity_samples: int
    seed: int

    def __post_init__(self) -> None:
        positive = ("links", "samples", "bend_max_rad", "slide_max_share", "compliance_force_n", "hidden", "iterations",
                    "tip_radius_m", "contact_stiffness_n_per_m", "compared_fits", "parity_samples")  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        for name in ("limit_margin_share", "contact_damping_n_s_per_m"):
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
    """Equilibria: pressure (S, n) Pa, tip (S, 3) m, fitted joints (S, 3), residual (S,) m, heldout (S,) bool."""

    pressure: np.ndarray
    tip: np.ndarray
    joints: np.ndarray
    residual: np.ndarray
    heldout: np.ndarray


def run(config: Config, robot: Robot, mesh: Mesh | None, reduced_model: ReducedModel, *, tracker: Tracker) -> Surrogate:
    """Return the surrogate fitted to the reduced model's equilibria."""
    return build_surrogate(
        config, robot, mesh, partial(model_tips, reduced_model), float(reduced_model.rest_tip[2]), tracker
    )


def model_tips(reduced_model: ReducedModel, loads: np.ndarray) -> np.ndarray:
    """Return the tips (S, 3) m of the reduced model at equilibrium under ``loads`` (S, n + 3) Pa and N."""
    return static_coordinates(reduced_model, loads)[:, -3:] + reduced_model.rest_tip


def build_surrogate(
    config: Config, robot: Robot, mesh: Mesh | None, tip_of: Statics, tip_height: float, tracker: Tracker
) -> Surrogate:
    """Return the surrogate of any body that ``tip_of`` describes: loads (S, n + 3) Pa and N -> tips (S, 3) m."""
    rng = np.random.default_rng(config.seed)
    dimensions = dimensions_of(robot, mesh, tip_height, config.links)
    chain = chain_from(dimensions.joint_height, dimensions.plane_height, dimensions.tip_height)
    samples = _sample(config, robot, dimensions, chain, tip_of, rng)
    stiffness, compliance = _springs(config, samples, chain, tip_of)
    surrogate = _assemble(config, robot, dimensions, samples, stiffness)
    return report(surrogate, samples.residual, compliance, config.compared_fits, config.parity_samples, tracker)


def _sample(
    config: Config, robot: Robot, dimensions: Dimensions, chain: Chain, tip_of: Statics, rng: np.random.Generator
) -> Samples:
    sobol = qmc.Sobol(robot.chambers, rng=rng).random_base2(int(np.ceil(np.log2(config.samples))))[: config.samples]
    pressure = robot.pressure_min_pa + sobol * (robot.pressure_max_pa - robot.pressure_min_pa)
    started = time.perf_counter()
    tip = tip_of(np.hstack([pressure, np.zeros((len(pressure), 3))]))
    found = np.isfinite(tip).all(axis=1)
    if found.mean() < 0.95:
        raise SolverError(f"{(~found).sum()} of {len(found)} sampled equilibria were not found; expected 5 % at most")
    pressure, tip = pressure[found], tip[found]
    gaps = len(dimensions.plane_height)
    bend, slide = (
        config.bend_max_rad / gaps,
        config.slide_max_share * float(np.diff(dimensions.plane_height, prepend=0).mean()),
    )
    limit = np.array([bend, bend, slide])
    fit = fit_joints(chain, tip, -limit, limit)
    log.info(
        "%d equilibria, fitted to %.2g mm rms in %.1f s", len(tip), 1e3 * np.sqrt(np.mean(fit.residual**2)),
        time.perf_counter() - started,
    )  # fmt: skip
    heldout = np.zeros(len(tip), dtype=bool)
    heldout[rng.permutation(len(tip))[: max(1, round(config.heldout_share * len(tip)))]] = True
    return Samples(pressure, tip, fit.theta, fit.residual, heldout)


def _springs(
    config: Config, samples: Samples, chain: Chain, tip_of: Statics
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return the joints' stiffness (3,), and joints and compliances of the held-out pressures."""
    chosen = np.linspace(0, len(samples.tip) - 1, min(config.compliance_samples, len(samples.tip))).astype(int)
    compliance = body_compliance(tip_of, samples.pressure[chosen], config.compliance_force_n)
    joints = samples.joints[chosen]
    stiffness = fit_joint_stiffness(joints[::2], chain, compliance[::2])
    return stiffness, (joints[1::2], compliance[1::2])


def _assemble(
    config: Config, robot: Robot, dimensions: Dimensions, samples: Samples, stiffness: np.ndarray
) -> Surrogate:
    seen = ~samples.heldout
    low, high = samples.joints.min(axis=0), samples.joints.max(axis=0)
    margin = config.limit_margin_share * (high - low)
    low, high = low - margin, high + margin
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
        joint_stiffness=stiffness,
        contact_stiffness_n_per_m=config.contact_stiffness_n_per_m,
        contact_damping_n_s_per_m=config.contact_damping_n_s_per_m,
        mass=robot.mass_kg,
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
    )
