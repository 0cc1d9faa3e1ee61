"""How the full model's tip yields to small forces and moments, from its own tangents, and how PyBullet's does."""

import logging
from typing import NamedTuple

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots
from softrl.artifacts.surrogate import Surrogate
from softrl.core.threads import one_thread
from softrl.core.tracking import Tracker
from softrl.fem.continuation import Missed, follow
from softrl.fem.material import material_of
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import load_scale
from softrl.robots.robot import Robot
from softrl.surrogate.kinematics import chain_of, joint_axes
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.stiffness import turn_between

log = logging.getLogger(__name__)
NEWTON = NewtonSettings(tolerance_m=1e-7, max_iterations=40, reuse_below=0.5)
LARGEST_LOAD_STEP = 0.8  # in units of ``sampling.load_scale``
SMALL_SHARE = 0.05  # of the largest force that the tip is made for: the force of the differences in PyBullet
ARM_SHARE = 0.3  # of the tip's height: the arm of their moment


class Yielding(NamedTuple):
    """What tips do under small loads, at some pressures.

    Attributes
    ----------
    pressure : (S, n) Pa;  tip : (S, 3) m there
    yields : (S, 6, 6) d (tip, turn) / d (force, moment), m and rad per N and N m
    """

    pressure: np.ndarray
    tip: np.ndarray
    yields: np.ndarray


def sampled_yielding(robot: Robot, mesh: Mesh, snapshots: Snapshots, count: int, seed: int) -> Yielding:
    """Return how the full model yields at rest, which comes first, and at ``count`` pressures."""
    rng = np.random.default_rng([seed, robot.chambers])
    pressure = rng.uniform(robot.pressure_min_pa, robot.pressure_max_pa, (count, robot.chambers))
    model = full_model(robot, mesh, snapshots)
    with one_thread():  # several add up in another order each time
        return full_yielding(model, robot, np.vstack([np.zeros((1, robot.chambers)), pressure]))


def full_model(robot: Robot, mesh: Mesh, snapshots: Snapshots) -> FemModel:
    """Return the model that the snapshots are of, with the robot's weight."""
    s = snapshots
    return FemModel(
        mesh, material_of(s.law, s.moduli_pa, s.poisson), robot.mass_kg / mesh.volume(), s.rayleigh_mass_per_s,
        s.rayleigh_stiffness_s, NEWTON, robot.gravity_m_s2, element_order=s.element_order,
        mean_dilatation=s.mean_dilatation,
    )  # fmt: skip


def full_yielding(model: FemModel, robot: Robot, pressure: np.ndarray) -> Yielding:
    """Return how the full model yields at ``pressure`` (S, n) Pa, by its tangents; pressures without equilibrium are left out."""
    plate, unit = model.coupling.body_slice(0), np.zeros((model.coupling.unknowns, 6))
    unit[plate] = np.eye(6)
    rows = []
    for found in follow(model, np.hstack([pressure, np.zeros((len(pressure), 3))]), load_scale(robot), LARGEST_LOAD_STEP):
        if isinstance(found, Missed):
            log.warning("the full model's stiffness is not told at one pressure: %s", found.reason)
            continue
        model.refactorise(found.pose, found.load)
        rows.append((found.load[: robot.chambers], model.tip(found.pose), model.solve(unit)[plate]))
    return Yielding(*(np.array(column) for column in zip(*rows, strict=True)))


def bullet_yielding(surrogate: Surrogate, pressure: np.ndarray, tip_force_max_n: float) -> Yielding:
    """Return how the surrogate yields in PyBullet at ``pressure`` (S, n) Pa, by differences of small forces and couples.

    They are small beside ``tip_force_max_n``, which the tip is made for.
    """
    from softrl.surrogate.parity import SETTLING, World, settle  # PyBullet starts slowly

    theta = PressureToJoints(surrogate).joints(pressure)
    world = World(surrogate, 1.0, SETTLING, 1.0)
    yields, tips = np.empty((len(theta), 6, 6)), np.empty((len(theta), 3))
    size = SMALL_SHARE * tip_force_max_n * np.repeat([1.0, ARM_SHARE * surrogate.tip_height], 3)
    for row, tip, command in zip(yields, tips, theta, strict=True):
        tip[:] = world.pose(settle(world, command, seconds=0.1))[0]
        for k, load in enumerate(np.diag(size)):
            ahead, behind = (world.pose(settle(world, command, sign * load)) for sign in (1.0, -1.0))
            turn = turn_between(behind[1][None], ahead[1][None])[0]
            row[:, k] = np.r_[ahead[0] - behind[0], turn] / (2.0 * size[k])
    world.close()
    return Yielding(np.asarray(pressure, dtype=float), tips, yields)


def stiffness_errors(chain: Yielding, full: Yielding, axis: np.ndarray) -> dict[str, np.ndarray]:
    """Return by which shares (S,) the chain is stiffer than the full model.

    ``x, y, z`` : force over how far the tip goes along it; ``bending`` : moment over how far the tip turns, across the
    tip's own ``axis`` (S, 3), where it differs most; ``turn`` : force over how far the tip turns, for the push that turns it
    most.
    """
    found = {name: full.yields[:, k, k] / chain.yields[:, k, k] - 1.0 for k, name in enumerate("xyz")}
    across = np.eye(3) - np.einsum("si,sj->sij", axis, axis)
    turn, body_turn = (np.einsum("sij,sjk->sik", across, y.yields[:, 3:, :3]) for y in (chain, full))
    left, _, right = np.linalg.svd(body_turn)
    along = [np.einsum("sij,si,sj->s", t, left[:, :, 0], right[:, 0]) for t in (body_turn, turn)]
    bends = [np.einsum("sij,sjk,skl->sil", across, y.yields[:, 3:, 3:], across) for y in (full, chain)]
    own = np.linalg.svd(across)[0][:, :, :2]  # two directions across the axis
    ratio = np.stack([np.einsum("sia,sij,sja->sa", own, b, own) for b in bends])
    bending = ratio[0] / ratio[1] - 1.0
    worst = np.abs(bending).argmax(axis=1)
    return found | {"bending": bending[np.arange(len(bending)), worst], "turn": along[0] / along[1] - 1.0}


def report_yielding(s: Surrogate, full: Yielding, tip_force_max_n: float, tracker: Tracker) -> None:
    """Log how much stiffer or softer than the full model the surrogate is in PyBullet: at rest, the first row, and in all rms."""
    theta = np.ascontiguousarray(PressureToJoints(s).joints(full.pressure))
    errors = stiffness_errors(bullet_yielding(s, full.pressure, tip_force_max_n), full, joint_axes(theta, chain_of(s))[1])
    tracker.metric("full_model/pressures_count", len(theta))
    for name, error in errors.items():
        key = f"tip_stiffness_{name}" if len(name) == 1 else f"{name}_stiffness"
        tracker.metric(f"full_model/rest_{key}_pct", 100.0 * float(abs(error[0])))
        tracker.metric(f"full_model/{key}_pct", 100.0 * float(np.sqrt(np.mean(error**2))))
