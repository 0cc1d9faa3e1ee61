"""The full model as a Simulator: the most faithful body, and by far the slowest."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.simulator import Hook, Motion
from softrl.effects.effect import (
    ADDED,
    BODY_PORT_ROWS,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    GRAVITY,
    LOAD_PORT_ROWS,
    PRESSURE,
    RATE,
    REST,
    STRAIN,
    TIP,
    TIP_VELOCITY,
)
from softrl.fem.continuation import follow
from softrl.fem.coupling import Pose
from softrl.fem.material import material_of
from softrl.fem.model import FemModel, State
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import load_scale
from softrl.robots.robot import Robot

TUNABLE = ("youngs_modulus_scale", "damping_scale", "mass_scale")
LARGEST_LOAD_STEP = 0.8  # of an equilibrium's continuation, in units of ``sampling.load_scale``


class FemState(NamedTuple):
    """A moving body with what the effects' ports need: volumes (n,) m^3 one step ago, tip velocity (3,) m/s."""

    body: State
    volume_before: np.ndarray
    tip_velocity: np.ndarray


@dataclass(frozen=True)
class FemSimulator:
    """The full finite-element model with weight, implemented as a Simulator.

    Attributes
    ----------
    robot : chambers, mass, gravity
    mesh : made by stage=mesh
    law, moduli_pa, poisson : the material, see ``fem.material.material_of``
    element_order : 2 for quadratic tetrahedra; 1 for linear ones, which lock and serve comparisons
    rayleigh_mass_per_s, rayleigh_stiffness_s : damping (a M + b K) v
    tolerance_m, max_iterations, reuse_below : see ``fem.newton.NewtonSettings``
    youngs_modulus_scale, damping_scale, mass_scale : factors on elastic energy, damping, inertia and weight

    Notes
    -----
    Effects inside the body act explicitly here: their ports are read where a step begins, an added pressure is taken
    off the chamber and an added force goes to the tip for that step. That is first order in the time step, as the
    step itself, and unstable for effects much stiffer than the body. A chamber's strain is
    ``(V - V_rest) / V_stressfree``; its elastic pressure is linearised at rest with the tip free.
    """

    robot: Robot
    mesh: Mesh
    law: str
    moduli_pa: tuple[float, ...]
    poisson: float
    element_order: int
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    tolerance_m: float
    max_iterations: int
    reuse_below: float
    youngs_modulus_scale: float
    damping_scale: float
    mass_scale: float

    def __post_init__(self) -> None:
        for name in TUNABLE:
            value, may_vanish = getattr(self, name), name == "damping_scale"
            if not np.isfinite(value) or value < 0 or (value == 0 and not may_vanish):
                raise ConfigError(f"simulator.{name}={value:g} must be positive")
        if self.mesh.chambers != self.robot.chambers:
            raise ArtifactError(
                f"the mesh of {self.mesh.robot_name} has {self.mesh.chambers} cavities, robot {self.robot.name} has "
                f"{self.robot.chambers} chambers; run stage=mesh for this robot"
            )

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
        )

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
        if found is None:
            raise SolverError(
                f"simulator fem: no equilibrium under {np.array2string(load, precision=4)} Pa, N and the weight; "
                "a stiffer material or a smaller load may have one"
            )
        return found.pose

    def equilibrium(self, pressure: np.ndarray) -> FemState:
        """Return the state at rest under ``pressure`` (n,) Pa and weight."""
        return self._still(self._equilibrium(np.r_[np.asarray(pressure, dtype=float), np.zeros(3)]))

    def reset(self, rng: np.random.Generator | None = None) -> FemState:
        """Return the state at rest under zero pressure and weight; ``rng`` is unused."""
        return self._still(self._rest)

    def _still(self, pose: Pose) -> FemState:
        return FemState(self.model.state(pose), self.model.volumes(pose), np.zeros(3))

    def step(
        self, state: FemState, pressure: np.ndarray, dt_s: float, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> FemState:
        """Return the state after ``dt_s`` under ``pressure`` (n,) Pa and ``tip_force`` (3,) N."""
        model, pose = self.model, state.body.pose
        acting = np.array(pressure, dtype=float)
        force = np.zeros(3) if tip_force is None else np.array(tip_force, dtype=float)
        gravity = model.gravity_m_s2
        if body:
            acting -= self._added_pressure(state, acting, dt_s, body)
        if load:
            added, gravity = self._added_force(state, dt_s, load)
            force += added
        moved, solve = model.step(state.body, np.r_[acting, force], dt_s, gravity)
        if not solve.converged:
            raise SolverError(
                f"simulator fem: a step of {dt_s:g} s did not converge in {solve.iterations} iterations; "
                "try a smaller dt_s, or weaker effects"
            )
        velocity = (model.tip(moved.pose) - model.tip(pose)) / dt_s
        return FemState(moved, model.volumes(pose), velocity)

    def _added_pressure(self, state: FemState, pressure: np.ndarray, dt_s: float, body: Sequence[Hook]) -> np.ndarray:
        """Return the resisting pressure (n,) Pa that the body effects add, and advance them."""
        scale = self.model.rest_volume
        change = self.model.volumes(state.body.pose) - self.model.volumes(self._rest)
        port = np.zeros((BODY_PORT_ROWS, self.robot.chambers))
        port[STRAIN] = change / scale
        port[RATE] = (self.model.volumes(state.body.pose) - state.volume_before) / (scale * dt_s)
        port[ELASTIC] = self._volume_stiffness @ change
        port[ELASTIC_SLOPE] = port[REST] = np.diag(self._volume_stiffness) * scale
        port[PRESSURE] = pressure
        for hook in body:
            hook.kernel(hook.parameters, hook.state, port, dt_s, True)
        return port[ADDED]

    def _added_force(self, state: FemState, dt_s: float, load: Sequence[Hook]) -> tuple[np.ndarray, np.ndarray]:
        """Return the tip force (3,) N and the gravity (3,) m/s^2 that the load effects make, and advance them."""
        port = np.zeros((LOAD_PORT_ROWS, 3))
        port[TIP], port[TIP_VELOCITY] = self.model.tip(state.body.pose), state.tip_velocity
        port[GRAVITY] = self.model.gravity_m_s2
        for hook in load:
            hook.kernel(hook.parameters, hook.state, port, dt_s, True)
        return port[FORCE], port[GRAVITY].copy()

    def observe(self, state: FemState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        return self.model.tip(state.body.pose), self.model.tip_quaternion(state.body.pose)

    def simulate(
        self, time: np.ndarray, pressure: np.ndarray, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, n), each row held until its time."""
        dt_s, state = float(time[1] - time[0]), self.reset()
        poses = []
        for k, row in enumerate(pressure):
            force = None if tip_force is None else tip_force[k]
            state = self.step(state, row, dt_s, force, body, load)
            poses.append(self.observe(state))
        position, quaternion = (np.stack(values) for values in zip(*poses, strict=True))
        return Motion(np.asarray(time, dtype=float), position, quaternion, np.array(pressure, dtype=float))
