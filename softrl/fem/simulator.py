"""The full model as a Simulator: the most faithful body, and by far the slowest."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.simulator import Hook, Motion
from softrl.effects.port import (
    ADDED,
    ADDED_SLOPE,
    COUPLED,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    FORCE_SLOPE,
    GRAVITY,
    LOAD_PORT_ROWS,
    PRESSURE,
    RATE,
    REST,
    STRAIN,
    TIP,
    TIP_VELOCITY,
    body_port,
)
from softrl.fem.continuation import Missed, follow, told
from softrl.fem.coupling import Pose
from softrl.fem.material import material_of
from softrl.fem.model import FemModel, State
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import load_scale
from softrl.robots.robot import Robot

TUNABLE = ("youngs_modulus_scale", "damping_scale", "mass_scale")
EFFECT_ITERATIONS, EFFECT_TOLERANCE = 30, 1e-9  # of a step with effects; share of the scale of the loads
QUASI_STATIC_S = 1e9  # one implicit step of this length is an equilibrium
REST_STEPS, REST_TOLERANCE_M = 20, 1e-9
LARGEST_LOAD_STEP = 0.8  # of an equilibrium's continuation, in units of ``sampling.load_scale``


class Hooks(NamedTuple):
    """The effects inside a step, by site, and the volumes (n,) m^3 at rest, from which they see strains."""

    body: Sequence[Hook]
    load: Sequence[Hook]
    rest: np.ndarray


class FemState(NamedTuple):
    """A moving body, and the volumes (n,) m^3 from which strains count: without them, those under weight alone."""

    body: State
    rest: np.ndarray | None = None


@dataclass(frozen=True)
class FemSimulator:
    """The full finite-element model with weight, implemented as a Simulator.

    Attributes
    ----------
    robot : chambers, mass, gravity
    mesh : made by stage=mesh
    law, moduli_pa, poisson : the material, see ``fem.material.material_of``
    element_order : 2 for quadratic tetrahedra; 1 for linear ones, which lock and serve comparisons
    mean_dilatation : see ``fem.model.FemModel``
    rayleigh_mass_per_s, rayleigh_stiffness_s : damping (a M + b K) v
    tolerance_m, max_iterations, reuse_below : see ``fem.newton.NewtonSettings``
    youngs_modulus_scale, damping_scale, mass_scale : factors on elastic energy, damping, inertia and weight
    layer_scales : (layers,) factors on the elastic energy of each layer, from below; ones if None

    Notes
    -----
    Effects act inside the implicit step: what they add to pressure and tip force is that of the step's end. A
    chamber's strain is ``(V - V_rest) / V_stressfree``; its elastic pressure is linearised at rest with the tip free, and zero at
    rest.
    """

    backward: ClassVar[bool] = True

    robot: Robot
    mesh: Mesh
    law: str
    moduli_pa: tuple[float, ...]
    poisson: float
    element_order: int
    mean_dilatation: bool
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    tolerance_m: float
    max_iterations: int
    reuse_below: float
    youngs_modulus_scale: float
    damping_scale: float
    mass_scale: float
    layer_scales: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        self.robot.check_upright("simulator fem")
        for name in TUNABLE:
            value, may_vanish = getattr(self, name), name == "damping_scale"
            if not np.isfinite(value) or value < 0 or (value == 0 and not may_vanish):
                raise ConfigError(f"simulator.{name}={value:g} must be positive")
        if self.mesh.chambers != self.robot.chambers:
            raise ArtifactError(
                f"the mesh of {self.mesh.robot_name} has {self.mesh.chambers} cavities, robot {self.robot.name} has "
                f"{self.robot.chambers} chambers; run stage=mesh for this robot"
            )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is cached: the linear solver's factors cannot travel."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters."""
        return {name: getattr(self, name) for name in TUNABLE}

    def with_parameters(self, **values: float) -> "FemSimulator":
        """Return a copy with some tunable parameters replaced."""
        unknown = set(values) - set(TUNABLE)
        if unknown:
            raise ConfigError(
                f"simulator fem has no parameter {', '.join(sorted(unknown))}; it has {', '.join(TUNABLE)}"
            )
        changed: dict[str, Any] = dict(values)
        return replace(self, **changed)

    @cached_property
    def model(self) -> FemModel:
        """The finite-element model with the robot's weight."""
        return FemModel(
            self.mesh, material_of(self.law, self.moduli_pa, self.poisson),
            self.mass_scale * self.robot.mass_kg / self.mesh.volume(),
            self.damping_scale * self.rayleigh_mass_per_s, self.damping_scale * self.rayleigh_stiffness_s,
            NewtonSettings(self.tolerance_m, self.max_iterations, self.reuse_below), self.robot.gravity_m_s2,
            self.youngs_modulus_scale, element_order=self.element_order,
            mean_dilatation=self.mean_dilatation, layer_scales=self.layer_scales,
        )

    @property
    def layers(self) -> int:
        """Number of layers of the wall."""
        return self.mesh.layers

    def with_layers(self, scales: tuple[float, ...]) -> "FemSimulator":
        """Return a copy whose layers, from below, are ``scales`` times as stiff as the model's."""
        return replace(self, layer_scales=tuple(scales))

    @cached_property
    def _rest(self) -> Pose:
        return self._equilibrium(np.zeros(self.robot.chambers + 3))

    @cached_property
    def _volume_stiffness(self) -> np.ndarray:
        """(n, n) Pa/m^3: pressure by volume at rest, tip free."""
        n = self.robot.chambers
        return np.linalg.inv(self.model.tangent(self._rest, np.zeros(n + 3)).compliance[:n, :n])

    def _equilibrium(self, load: np.ndarray) -> Pose:
        found = next(follow(self.model, load[None], load_scale(self.robot), LARGEST_LOAD_STEP))
        if isinstance(found, Missed):
            raise SolverError(
                f"simulator fem: no equilibrium under {told(load)} Pa, N and the weight: "
                f"{found.reason}; a stiffer material or a smaller load may have one"
            )
        return found.pose

    def equilibrium(self, pressure: np.ndarray, tip_force: np.ndarray | None = None) -> FemState:
        """Return the state at rest under ``pressure`` (n,) Pa, ``tip_force`` (3,) N and weight."""
        force = np.zeros(3) if tip_force is None else np.asarray(tip_force, dtype=float)
        return self._still(self._equilibrium(np.r_[np.asarray(pressure, dtype=float), force]))

    def reset(self, rng: np.random.Generator | None = None) -> FemState:
        """Return the state at rest under zero pressure and weight; ``rng`` is unused."""
        return self._still(self._rest)

    def _still(self, pose: Pose) -> FemState:
        return FemState(self.model.state(pose))

    def step(
        self, state: FemState, pressure: np.ndarray, dt_s: float, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> FemState:
        """Return the state after ``dt_s`` under ``pressure`` (n,) Pa and ``tip_force`` (3,) N."""
        self.model.forget()  # so that a step depends on nothing but its arguments
        rest = self.model.volumes(self._rest) if state.rest is None else state.rest
        return self._step(state, pressure, dt_s, tip_force, Hooks(body, load, rest))._replace(rest=state.rest)

    def _step(
        self, state: FemState, pressure: np.ndarray, dt_s: float, tip_force: np.ndarray | None, hooks: Hooks
    ) -> FemState:
        given = np.r_[np.asarray(pressure, dtype=float), np.zeros(3) if tip_force is None else np.asarray(tip_force)]
        if not hooks.body and not hooks.load:
            return self._advance(state, given, dt_s, self.model.gravity_m_s2, None)
        return self._advance_with_effects(state, given, dt_s, hooks)

    def _advance(
        self, state: FemState, load: np.ndarray, dt_s: float, gravity: np.ndarray, start: Pose | None
    ) -> FemState:
        moved, solve = self.model.step(state.body, load, dt_s, gravity, start)
        if solve.failure:
            hint = "try a smaller dt_s, or weaker effects"
            raise SolverError(f"simulator fem: a step of {dt_s:g} s failed, {solve.failure}; {hint}")
        return FemState(moved)

    def _advance_with_effects(self, state: FemState, given: np.ndarray, dt_s: float, hooks: Hooks) -> FemState:
        """Find the load at which the body ends the step where the effects add just that load; then commit them.

        Newton's iteration in the few loads: the body answers them by the compliance of the step, the effects by the
        slopes they report.
        """
        scale = load_scale(self.robot)
        trial, acting = state, given
        share, before = 1.0, np.inf  # effects with kinks make whole steps swing to and fro
        for _ in range(EFFECT_ITERATIONS):
            added, slope, gravity = self._reaction(trial, state, given, dt_s, hooks, commit=False)
            miss = given + added - acting
            if trial is not state and np.abs(miss / scale).max() < EFFECT_TOLERANCE:
                self._reaction(trial, state, given, dt_s, hooks, commit=True)
                return trial
            if trial is state:
                trial = self._advance(state, acting, dt_s, gravity, None)
                continue
            size = float(np.abs(miss / scale).max())
            share = max(0.1, 0.5 * share) if size > 0.9 * before else min(1.0, 1.5 * share)
            before = size
            response = self.model.response(trial.body.pose)
            acting = acting + share * np.linalg.solve(np.eye(len(acting)) - slope @ response, miss)
            trial = self._advance(state, acting, dt_s, gravity, trial.body.pose)
        raise SolverError(
            f"simulator fem: the effects found no balance with the body in a step of {dt_s:g} s "
            f"({np.abs(miss / scale).max():.1e} of the load's scale left); try a smaller dt_s, or weaker effects"
        )

    def _reaction(
        self, trial: FemState, state: FemState, given: np.ndarray, dt_s: float, hooks: Hooks, commit: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what the effects add to the load at ``trial`` (n + 3,), its slope by (volumes, tip), and gravity."""
        n, model = self.robot.chambers, self.model
        scale, pose = model.rest_volume, trial.body.pose
        change = model.volumes(pose) - hooks.rest
        moved = model.volumes(pose) - model.volumes(state.body.pose)
        port = body_port(n)
        port[STRAIN], port[RATE] = change / scale, moved / (scale * dt_s)
        port[ELASTIC] = self._volume_stiffness @ change
        port[ELASTIC_SLOPE] = port[REST] = np.diag(self._volume_stiffness) * scale
        port[PRESSURE] = given[:n]
        for hook in hooks.body:
            hook.kernel(hook.parameters, hook.state, port, dt_s, commit)
        tip = np.zeros((LOAD_PORT_ROWS, 3))
        tip[TIP], tip[GRAVITY] = model.tip(pose), model.gravity_m_s2
        tip[TIP_VELOCITY] = (tip[TIP] - model.tip(state.body.pose)) / dt_s
        for hook in hooks.load:
            hook.kernel(hook.parameters, hook.state, tip, dt_s, commit)
        slope = np.zeros((n + 3, n + 3))
        slope[:n, :n] = -(np.diag(port[ADDED_SLOPE]) + port[COUPLED:]) / scale
        slope[n:, n:] = tip[FORCE_SLOPE : FORCE_SLOPE + 3]
        return np.r_[-port[ADDED], tip[FORCE]], slope, tip[GRAVITY].copy()

    def at_rest(self, load: Sequence[Hook]) -> FemState:
        """Return the state at rest under weight and ``load`` effects, whose states follow; strains count from there."""
        state = self._rest_under(load)
        return state._replace(rest=self.model.volumes(state.body.pose))

    def _rest_under(self, load: Sequence[Hook]) -> FemState:
        """Return the state at rest under weight and the load effects, by steps so long that nothing moves freely."""
        state, shift = self.reset(), 0.0
        for _ in range(REST_STEPS if load else 0):
            found = self.step(state, np.zeros(self.robot.chambers), QUASI_STATIC_S, load=load)
            shift = float(np.abs(found.body.pose.position - state.body.pose.position).max())
            state = self._still(found.body.pose)
            if shift < REST_TOLERANCE_M:
                break
        if shift > max(REST_TOLERANCE_M, self.tolerance_m):
            raise SolverError(
                f"simulator fem: under the load's effects the body came not to rest in {REST_STEPS} rounds ({shift:.1e} m in the "
                "last one); try weaker effects"
            )
        return state

    def observe(self, state: FemState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        return self.model.tip(state.body.pose), self.model.tip_quaternion(state.body.pose)

    def simulate(
        self, time: np.ndarray, pressure: np.ndarray, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, n), each row held until its time.

        Rest is the equilibrium under weight and the load effects; strains that body effects see count from there.
        """
        dt_s, state = float(time[1] - time[0]), self._rest_under(load)
        hooks = Hooks(body, load, self.model.volumes(state.body.pose))
        self.model.forget()  # within a run the factors are kept from step to step
        poses = []
        for k, row in enumerate(pressure):
            force = None if tip_force is None else tip_force[k]
            state = self._step(state, row, dt_s, force, hooks)
            poses.append(self.observe(state))
        position, quaternion = (np.stack(values) for values in zip(*poses, strict=True))
        return Motion(np.asarray(time, dtype=float), position, quaternion, np.array(pressure, dtype=float))
