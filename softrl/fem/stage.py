"""fem: equilibria and motions of the full finite-element model, as snapshots for a reduced one."""

import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots
from softrl.core import fingerprint
from softrl.core.errors import ConfigError, SolverError
from softrl.core.parallel import LOCAL, Parallel
from softrl.core.progress import progress
from softrl.core.resume import Kept, pack, unpack
from softrl.core.tracking import Tracker
from softrl.fem.chain import SLOPE, Chain, Found, Lost, chain_of, trace
from softrl.fem.continuation import Missed, follow
from softrl.fem.figures import draw_newton, draw_shapes, draw_stretch, draw_tips, draw_trajectories
from softrl.fem.material import Material, material_of
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import corner_loads, load_scale, paths, sobol_loads, step_program, with_waypoints
from softrl.fem.trajectory import Trajectory, roll_out
from softrl.fem.weight import pull_at_rest
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
CORNERS = 4  # Sobol samples for each corner of the pressures' range at least
FORETOLD = 200  # equilibria of which is said beforehand how long they take
TRIED = 3  # equilibria and steps that tell


@dataclass(frozen=True)
class Config:
    """Static sampling of the full model without gravity, round the stress-free mesh; motions under the robot's weight."""

    law: str  # stable_neo_hookean, yeoh, mooney_rivlin or st_venant_kirchhoff
    moduli_pa: tuple[float, ...]  # Young's modulus; yeoh: c1, c2, c3; mooney_rivlin: c10, c01
    poisson: float
    element_order: int  # 2: quadratic tetrahedra; 1: linear ones, which are far too stiff
    mean_dilatation: bool  # changes of volume are weighed by their mean over an element; see FemModel
    equilibria: int  # Sobol samples of the loads, beside corners of the pressures' range, one in CORNERS of these at most
    faces_share: float  # share of them with one pressure at its limit
    tip_force_scale: float  # largest sampled tip force over the robot's: inertia and weight pull at a body like more
    weight_share: float  # of the weight's pull at the tip at rest, about which tip forces are sampled
    load_step: float  # longest load step, in units of (half the pressure range, radius or middle of the sampled tip forces)
    paths: int  # warm-started chains of samples; more are better balanced, each begins at rest
    trajectories: int
    duration_s: float  # of each trajectory
    hold_s: float  # of each level in it
    dt_s: float
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    tolerance_m: float  # Newton ends below this nodal step
    max_iterations: int
    reuse_below: float  # keep the factors while steps shrink faster than this
    max_failed_share: float  # more samples without an equilibrium are an error
    processes: int
    seed: int

    def __post_init__(self) -> None:
        least = {"equilibria": 1, "paths": 1, "trajectories": 0, "processes": 1}
        if self.element_order not in (1, 2):
            raise ConfigError(f"stage.element_order={self.element_order}; expected 2 (quadratic) or 1 (linear)")
        for key, low in least.items():
            if getattr(self, key) < low:
                raise ConfigError(f"stage.{key}={getattr(self, key)} must be at least {low}")
        for key in ("tip_force_scale", "load_step", "duration_s", "hold_s", "dt_s"):
            if not getattr(self, key) > 0:
                raise ConfigError(f"stage.{key}={getattr(self, key):g} must be positive")
        if self.trajectories and self.steps < 2:
            raise ConfigError(
                f"stage.duration_s={self.duration_s:g} is {self.steps} steps of stage.dt_s={self.dt_s:g}; expected two or more, "
                "or stage.trajectories=0"
            )
        for key in ("faces_share", "weight_share", "max_failed_share"):
            if not 0 <= getattr(self, key) <= 1:
                raise ConfigError(f"stage.{key}={getattr(self, key):g} is outside 0..1")
        for key in ("rayleigh_mass_per_s", "rayleigh_stiffness_s"):
            if getattr(self, key) < 0:
                raise ConfigError(f"stage.{key}={getattr(self, key):g} must not be negative")

    @property
    def steps(self) -> int:
        """Number of time steps of a trajectory."""
        return round(self.duration_s / self.dt_s)


class Body(NamedTuple):
    """What a worker needs to build the model."""

    config: Config
    robot: Robot
    mesh: Mesh
    material: Material


class Plan(NamedTuple):
    """What is to be computed.

    Attributes
    ----------
    loads : (samples, chambers + 3) Pa and N;  chains : their row numbers in the order of paths
    scale : (chambers + 3,) unit of ``stage.load_step``
    programs : loads (steps, chambers + 3) of each motion
    """

    loads: np.ndarray
    chains: list[np.ndarray]
    scale: np.ndarray
    programs: list[np.ndarray]


def run(
    config: Config, robot: Robot, mesh: Mesh, parallel: Parallel | None = None, *, tracker: Tracker
) -> Snapshots:
    """Return equilibria over the robot's loads, with tangents, and trajectories of the full model.

    Notes
    -----
    The mesh is the stress-free shape. Equilibria are without gravity, which a reduced model adds through what each tells
    of the centre of mass; the trajectories, which are there to judge it, begin at rest under the weight. Loads whose
    equilibrium is not found, or only behind a jump (``fem.continuation``), are counted in ``failed``, listed in
    ``failed_loads.csv`` with the reason, and left out. Finished chains and trajectories are kept under the working
    directory until the stage ends, so that a killed run goes on.
    """
    robot.check_upright("stage=fem")
    body = Body(config, robot, mesh, material_of(config.law, config.moduli_pa, config.poisson))
    pulled = replace(robot, tip_force_max_n=config.tip_force_scale * robot.tip_force_max_n)
    centre = config.weight_share * pull_at_rest(build_model(body), np.array(robot.gravity_m_s2))[robot.chambers :]
    even = sobol_loads(pulled, config.equilibria, config.faces_share, centre, config.seed)
    loads = np.vstack([even, corner_loads(pulled, config.equilibria // CORNERS, centre)])
    scale = load_scale(pulled, centre)
    loads, chains = with_waypoints(loads, paths(loads, scale, config.paths), scale, config.load_step)
    clock = np.arange(1, config.steps + 1) * config.dt_s
    programs = [
        step_program(robot, clock, config.hold_s, rng)
        for rng in np.random.default_rng(config.seed).spawn(config.trajectories)
    ]
    began = time.monotonic()
    kept = Kept("fem", _mark(body))
    plan = Plan(loads, chains, scale, programs)
    samples, misses, trajectories, reused = _compute(body, plan, parallel or LOCAL, kept)
    tracker.metric("parts_resumed", reused)
    log.info("%d equilibria and %d trajectories in %.0f s", len(samples), len(trajectories), time.monotonic() - began)
    _record_failures(loads, misses, tracker)
    _refuse_failures(misses, len(loads), config)
    snapshots = _collect(body, loads, samples, clock, trajectories)
    _report(snapshots, samples, config.trajectories, tracker)
    tracker.figure("deformed_shapes", draw_shapes(mesh, snapshots))
    tracker.figure("stretch", draw_stretch(mesh, snapshots))
    tracker.figure("sampled_tips", draw_tips(snapshots))
    tracker.figure("newton_convergence", draw_newton([cost.steps_m for _, _, cost in samples], config.tolerance_m))
    tracker.figure("trajectories", draw_trajectories(snapshots))
    kept.clear()
    return snapshots


def build_model(body: Body, gravity_m_s2: tuple[float, ...] = (0.0, 0.0, 0.0)) -> FemModel:
    """Return the model that ``body`` describes; its density gives the robot its mass."""
    config = body.config
    newton = NewtonSettings(config.tolerance_m, config.max_iterations, config.reuse_below)
    return FemModel(
        body.mesh, body.material, body.robot.mass_kg / body.mesh.volume(), config.rayleigh_mass_per_s,
        config.rayleigh_stiffness_s, newton, gravity_m_s2, element_order=config.element_order,
        mean_dilatation=config.mean_dilatation,
    )


def _compute(
    body: Body, plan: Plan, parallel: Parallel, kept: Kept
) -> tuple[list[Found], list[Lost], list[Trajectory], int]:
    """Work off all chains and programs in parallel; the result does not depend on where, or after how many kills.

    Returns equilibria and misses in the order of ``loads``, trajectories in that of ``programs``, and how many parts
    an earlier run had kept.
    """
    loads, chains, scale, programs = plan
    # the longest first: else one core works off the last of them while the others wait
    tasks: dict[str, tuple[Any, ...]] = {f"trajectory_{k}": (_move, body, program) for k, program in enumerate(programs)}
    longest = sorted(range(len(chains)), key=lambda k: -len(chains[k]))
    tasks |= {f"chain_{k}": (_trace, body, loads, scale, chains[k]) for k in longest}
    # in memory from here on: another run of the same samples may end first, and clears the folder
    parts = {name: kept.load(name) for name in tasks if name in kept}
    waiting, reused = [name for name in tasks if name not in parts], len(parts)
    if reused:
        log.info("%d of %d chains and trajectories were finished by an earlier run and are kept", reused, len(tasks))
    if len(waiting) == len(tasks) and len(loads) >= FORETOLD:
        _foretell(body, plan)
    results = parallel.map(_part, [tasks[name] for name in waiting], body.config.processes)
    for number, arrays in progress(results, "FEM: motions, then chains of equilibria", len(waiting)):
        parts[waiting[number]] = arrays
        kept.save(waiting[number], arrays)
    traced = [chain_of(parts[f"chain_{k}"]) for k in range(len(chains))]
    samples = sorted((found for chain in traced for found in chain.found), key=lambda f: f[0])
    misses = sorted(lost for chain in traced for lost in chain.missed)
    moved = [parts[f"trajectory_{k}"] for k in range(len(programs))]
    return samples, misses, [unpack(Trajectory, arrays) for arrays in moved if arrays], reused


def _foretell(body: Body, plan: Plan) -> None:
    """Log about how long all will take, by a few equilibria and steps: the first part of many ends only after minutes."""
    loads, chains, scale, programs = plan
    began = time.monotonic()
    _trace(body, loads, scale, chains[0][:TRIED])
    traced = time.monotonic()
    for program in programs[:1]:
        _move(body, program[:TRIED])
    equilibrium_s, step_s = (traced - began) / TRIED, (time.monotonic() - traced) / TRIED
    spent_s = equilibrium_s * len(loads) + step_s * sum(len(program) for program in programs)
    processes = body.config.processes
    log.info(
        "FEM: %d equilibria at %.1f s and %d motions of %d steps at %.1f s: about %.0f min in %d processes", len(loads),
        equilibrium_s, len(programs), len(programs[0]) if programs else 0, step_s, spent_s / processes / 60.0, processes,
    )  # fmt: skip


def _mark(body: Body) -> str:
    """Return a hash of what the samples depend on: settings, robot, mesh and code, not the number of processes."""
    config = asdict(body.config) | {"processes": None}
    arrays = {field.name: getattr(body.mesh, field.name) for field in fields(body.mesh)}
    code = fingerprint.of_code(__name__)
    return fingerprint.of_values([config, asdict(body.robot), fingerprint.of_arrays(arrays), code])


def _part(compute: Callable[..., Chain | Trajectory | None], *arguments: Any) -> dict[str, np.ndarray]:
    """Return one chain or trajectory as arrays; none where a trajectory failed."""
    made = compute(*arguments)
    if made is None:
        return {}
    return made.arrays() if isinstance(made, Chain) else pack(made)


def _trace(body: Body, loads: np.ndarray, scale: np.ndarray, chain: np.ndarray) -> Chain:
    """Return the equilibria of the rows in ``chain``, and which of them are missed."""
    return trace(build_model(body), loads, chain, scale, body.config.load_step)


def _move(body: Body, program: np.ndarray) -> Trajectory | None:
    """Return the motion under ``program`` and weight, or None, with a warning, where a step does not converge."""
    model = build_model(body, body.robot.gravity_m_s2)
    try:
        rest = next(follow(model, np.zeros((1, program.shape[1])), load_scale(body.robot), body.config.load_step))
        if isinstance(rest, Missed):
            raise SolverError(f"no rest under the robot's weight: {rest.reason}")
        return roll_out(model, program, body.config.dt_s, rest.pose)
    except SolverError as failure:
        log.warning("a trajectory is left out: %s", failure)
        return None


def _record_failures(loads: np.ndarray, misses: list[Lost], tracker: Tracker) -> None:
    """Keep the loads that found no equilibrium with the run, one a line, each with its reason."""
    tracker.metric("jumps", sum(miss.jumped for _, miss in misses))
    if misses:
        n = loads.shape[1] - 3
        names = ["sample", *(f"p{k + 1}_pa" for k in range(n)), "force_x_n", "force_y_n", "force_z_n", "reason"]
        rows = [
            ",".join([str(number), *(f"{value:.9g}" for value in loads[number]), f'"{miss.reason}"'])
            for number, miss in misses
        ]
        tracker.text("failed_loads.csv", "\n".join([",".join(names), *rows]) + "\n")


def _refuse_failures(misses: list[Lost], samples: int, config: Config) -> None:
    failed, jumps = len(misses), sum(miss.jumped for _, miss in misses)
    if failed > config.max_failed_share * samples or failed == samples:
        remedy = "use a smaller stage.load_step, or check mesh and material"
        if 2 * jumps > failed:  # a shorter step changes nothing
            remedy = "narrow the robot's pressures or tip_force_max_n, or use a stiffer material or thicker walls"
        raise SolverError(
            f"{failed} of {samples} loads found no equilibrium, {jumps} of them but behind a jump, more than "
            f"stage.max_failed_share={config.max_failed_share:g}; the first, sample {misses[0][0]}: "
            f"{misses[0][1].reason}; {remedy}"
        )


def _collect(
    body: Body, loads: np.ndarray, samples: list[Found], clock: np.ndarray, trajectories: list[Trajectory]
) -> Snapshots:
    """Return the artifact; rows keep the order of ``loads``."""
    config, model = body.config, build_model(body)
    width = loads.shape[1]
    columns = {name: np.array([row[name] for _, row, _ in samples]) for name in samples[0][1]}
    slopes = {name.removeprefix(SLOPE): columns.pop(name) for name in list(columns) if name.startswith(SLOPE)}
    empty = np.zeros((0, len(clock), width))
    return Snapshots(
        loads=loads[[number for number, _, _ in samples]],
        **columns,
        slopes=slopes,
        moment_gram=model.moment_gram,
        nodal_mass=corner_mass(model),
        trajectory_time=clock,
        trajectory_load=np.array([t.load for t in trajectories]) if trajectories else empty,
        trajectory_coordinate=np.array([t.coordinate for t in trajectories]) if trajectories else empty,
        trajectory_quaternion=(
            np.array([t.quaternion for t in trajectories]) if trajectories else np.zeros((0, len(clock), 4))
        ),
        trajectory_gravity_m_s2=np.array(body.robot.gravity_m_s2, dtype=float),
        rest_tip=model.rest_tip,
        rest_volume=model.rest_volume,
        mass=float(model.nodal_mass.sum()),
        law=config.law,
        moduli_pa=config.moduli_pa,
        element_order=config.element_order,
        mean_dilatation=config.mean_dilatation,
        youngs_modulus_pa=body.material.youngs_modulus_pa,
        poisson=body.material.poisson,
        density_kg_m3=body.robot.mass_kg / body.mesh.volume(),
        rayleigh_mass_per_s=config.rayleigh_mass_per_s,
        rayleigh_stiffness_s=config.rayleigh_stiffness_s,
        failed=len(loads) - len(samples),
        robot_name=body.mesh.robot_name,
    )


def corner_mass(model: FemModel) -> np.ndarray:
    """Return the mass (corners,) kg of the corner nodes once each mid-edge node has given half to either end."""
    solid = model.solid
    mass = model.nodal_mass[: solid.corners].copy()
    np.add.at(mass, solid.edge_ends, 0.5 * model.nodal_mass[solid.corners :, None])
    return mass


def _report(
    snapshots: Snapshots, samples: list[Found], trajectories: int, tracker: Tracker
) -> None:
    tip = snapshots.coordinate[:, -3:]
    tracker.metric("equilibria", len(samples))
    tracker.metric("failed", snapshots.failed)
    tracker.metric("load_steps_halved", sum(cost.halvings for _, _, cost in samples))
    tracker.metric("trajectories_failed", trajectories - len(snapshots.trajectory_load))
    tracker.metric("newton_iterations_mean", float(np.mean([cost.iterations for _, _, cost in samples])))
    tracker.metric("factorisations_mean", float(np.mean([cost.factorisations for _, _, cost in samples])))
    tracker.metric("seconds_per_equilibrium_s", float(np.mean([cost.seconds for _, _, cost in samples])))
    for axis, extent in zip("xyz", np.ptp(tip, axis=0), strict=True):
        tracker.metric(f"tip_range_{axis}_mm", 1e3 * float(extent))
    tracker.metric("tip_range_mm", 1e3 * float(np.linalg.norm(tip, axis=1).max()))
