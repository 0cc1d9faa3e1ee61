"""The reduced body as a Simulator: the default body of everything downstream."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.simulator import Hook, Motion
from softrl.effects.call import Calls, pack, unpack
from softrl.pod.rom import LOAD_STEPS, NO_HOOKS, QUASI_STATIC_S, STILL
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.pose import tip_pose
from softrl.pod.step.potential import Tables
from softrl.pod.step.reach import warn_beyond
from softrl.pod.step.tables import tables_of
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)

TUNABLE = ("youngs_modulus_scale", "damping_scale", "mass_scale")
FAILED_SHARE = 0.01


class RomState(NamedTuple):
    """Coordinates z (n + 3,), chambers' volumes then tip relative to stress-free rest, m^3 and m; their velocity.

    ``inner`` (2, 6) is how far the body's inside gives beyond what weight makes it give, and its rate, see ``pod.step.inside``.
    ``gravity`` m/s^2 is that which acted last, as effects may have turned it: by it the tip turns. ``rest`` (n + 3,) are the
    coordinates from which strains count; without it, those under weight alone.
    """

    coordinates: np.ndarray
    velocity: np.ndarray
    inner: np.ndarray
    gravity: tuple[float, ...]
    rest: np.ndarray | None = None


@dataclass(frozen=True)
class RomSimulator:
    """The energy ROM in ``n + 3`` coordinates with weight, implemented as a Simulator.

    Attributes
    ----------
    robot : chambers and gravity
    reduced_model : made by stage=pod from this robot's snapshots
    youngs_modulus_scale : of the elastic energy, and of the stiffness in the damping
    damping_scale : of the Rayleigh damping
    mass_scale : of inertia and weight
    layer_scales : (layers,) of the elastic energy of each layer, from below; ones if None

    Notes
    -----
    Implicit Euler, see ``pod.step.kernel``. A chamber's strain is ``(V - V_rest) / V_stressfree``; its elastic pressure is
    ``dW/dV`` less the weight's share, zero at rest. An added pressure resists the volume itself, so it enters the step
    exactly. ``ELASTIC_SLOPE`` holds the other volumes and leaves the tip free.
    """

    backward: ClassVar[bool] = True

    robot: Robot
    reduced_model: ReducedModel
    youngs_modulus_scale: float
    damping_scale: float
    mass_scale: float
    layer_scales: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        self.robot.check_upright("simulator rom")
        for name in TUNABLE:
            value, least = getattr(self, name), 0.0
            if not np.isfinite(value) or value < least or (value == least and name != "damping_scale"):
                raise ConfigError(f"simulator.{name}={value:g} must be positive")
        if self.reduced_model.chambers != self.robot.chambers:
            raise ArtifactError(
                f"the ReducedModel of {self.reduced_model.robot_name} has {self.reduced_model.chambers} chambers, "
                f"robot {self.robot.name} has {self.robot.chambers}; run stage=pod for this robot"
            )

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters, factors on the reduced model's own."""
        return {name: getattr(self, name) for name in TUNABLE}

    def with_parameters(self, **values: float) -> "RomSimulator":
        """Return a copy with some tunable parameters replaced."""
        unknown = set(values) - set(TUNABLE)
        if unknown:
            raise ConfigError(
                f"simulator rom has no parameter {', '.join(sorted(unknown))}; it has {', '.join(TUNABLE)}"
            )
        return replace(self, **values)

    @property
    def layers(self) -> int:
        """Number of layers of the wall."""
        return self.reduced_model.layers

    def with_layers(self, scales: tuple[float, ...]) -> "RomSimulator":
        """Return a copy whose layers, from below, are ``scales`` times as stiff as the model's."""
        return replace(self, layer_scales=tuple(scales))

    @cached_property
    def _tables(self) -> Tables:
        gravity = np.array(self.robot.gravity_m_s2)
        return tables_of(self.reduced_model, gravity, **self.parameters, layer_scales=self.layer_scales)

    @cached_property
    def _rest(self) -> np.ndarray:
        """The equilibrium y (r,) under weight alone."""
        return self._equilibrium(NO_HOOKS)

    def _equilibrium(self, hooks: tuple[Calls, Calls], held: np.ndarray | None = None) -> np.ndarray:
        """Return the equilibrium y (r,) under weight, load effects and the loads ``held`` (r,) Pa and N."""
        r = self.reduced_model.order
        loads_only = NO_HOOKS[0], hooks[1]
        load = np.zeros((LOAD_STEPS, r))
        if held is not None:
            load[:] = np.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:, None] * held
        y = np.zeros(r)
        for _ in range(LOAD_STEPS):
            before = y.copy()
            # a step on the way may fail, as where the tip is thrown out of a surface: what counts is where it comes to rest
            still = np.zeros(r), STILL.copy(), np.zeros(r)
            self._run(y, *still, QUASI_STATIC_S, load, loads_only, 0, 1.0, "equilibria")
            load[:] = load[-1]
            if np.abs(y - before).max() < 1e-8:
                break
        self._run(y, np.zeros(r), STILL.copy(), np.zeros(r), QUASI_STATIC_S, load, loads_only, 0, what="equilibria")
        return y

    def _run(
        self,
        y: np.ndarray,
        velocity: np.ndarray,
        inner: np.ndarray,
        rest: np.ndarray,
        dt_s: float,
        load: np.ndarray,
        hooks: tuple[Calls, Calls],
        poses: int,
        failed_share: float = FAILED_SHARE,
        what: str = "motion",
    ) -> tuple[np.ndarray, np.ndarray, tuple[float, ...]]:
        """Advance what moves in place; return ``poses`` positions (., 3) and quaternions (., 4), and the gravity felt last."""
        position, quaternion = np.empty((poses, 3)), np.empty((poses, 4))
        path = np.empty((0, len(y)))
        failed, farthest, felt = run_kernel(
            y, velocity, inner, rest, dt_s, load, self._tables, hooks, path, position, quaternion
        )
        if failed > failed_share * len(load) or not np.isfinite(y).all():
            raise SolverError(
                f"simulator rom: {failed} of {len(load)} steps of {dt_s:g} s did not converge; "
                "try a smaller dt_s, pressures within the snapshots' range, or weaker effects"
            )
        warn_beyond(self.reduced_model, farthest, what)
        return position, quaternion, felt

    def _loads(self, pressure: np.ndarray, tip_force: np.ndarray | None) -> np.ndarray:
        """Return the loads (steps, n + 3) Pa and N."""
        n = self.robot.chambers
        held = np.asarray(pressure, dtype=float).reshape(-1, n)
        load = np.zeros((len(held), n + 3))
        load[:, :n] = held
        if tip_force is not None:
            load[:, n:] = np.asarray(tip_force, dtype=float).reshape(-1, 3)
        return load

    def equilibrium(self, pressure: np.ndarray, tip_force: np.ndarray | None = None) -> RomState:
        """Return the state at rest under ``pressure`` (n,) Pa, ``tip_force`` (3,) N and weight."""
        z = self.reduced_model.frame @ self._equilibrium(NO_HOOKS, self._loads(pressure, tip_force)[0])
        return RomState(z, np.zeros_like(z), STILL.copy(), self.robot.gravity_m_s2)

    def reset(self, rng: np.random.Generator | None = None) -> RomState:
        """Return the state at rest under zero pressure and weight; ``rng`` is unused."""
        z = self.reduced_model.frame @ self._rest
        return RomState(z, np.zeros_like(z), STILL.copy(), self.robot.gravity_m_s2)

    def at_rest(self, load: Sequence[Hook]) -> RomState:
        """Return the state at rest under weight and ``load`` effects, whose states follow; strains count from there."""
        if not load:
            return self.reset()
        hooks = NO_HOOKS[0], pack(load)
        rest = self._equilibrium(hooks)
        moving, none = (rest.copy(), np.zeros(len(rest)), STILL.copy()), np.zeros((1, len(rest)))
        _, _, felt = self._run(*moving, rest, QUASI_STATIC_S, none, hooks, 0, what="equilibria")
        unpack(hooks[1], load)
        z = self.reduced_model.frame @ rest
        return RomState(z, np.zeros_like(z), STILL.copy(), felt, z)

    def step(
        self,
        state: RomState,
        pressure: np.ndarray,
        dt_s: float,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> RomState:
        """Return the state after ``dt_s`` under ``pressure`` (n,) Pa and ``tip_force`` (3,) N.

        Several rows of both, (steps, n) and (steps, 3), are held for ``dt_s`` each. Strains that body effects see count
        from the state's own rest.
        """
        tables = self._tables
        y, velocity = (tables.inverse @ part for part in state[:2])
        inner = state.inner.copy()
        held = self._loads(pressure, tip_force)
        hooks = pack(body), pack(load)
        rest = self._rest if state.rest is None else tables.inverse @ state.rest
        _, _, felt = self._run(y, velocity, inner, rest, float(dt_s), held, hooks, 0)
        unpack(hooks[0], body)
        unpack(hooks[1], load)
        return RomState(*(tables.frame @ part for part in (y, velocity)), inner, felt, state.rest)

    def observe(self, state: RomState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        tables = self._tables
        position, quaternion = np.empty(3), np.empty(4)
        values, point = np.empty(len(tables.parent)), np.empty(len(tables.frame))
        y, felt = tables.inverse @ state.coordinates, np.array(state.gravity, dtype=float)
        tip_pose(y, state.inner[0], felt, tables, values, point, position, quaternion)
        return position, quaternion

    def simulate(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, n), each row held until its time.

        Rest is the equilibrium under weight and the load effects; strains that body effects see count from there.
        """
        hooks = pack(body), pack(load)
        rest = self._equilibrium(hooks) if load else self._rest
        held = self._loads(pressure, tip_force)
        moving = rest.copy(), np.zeros(len(rest)), STILL.copy()
        position, quaternion, _ = self._run(*moving, rest, float(time[1] - time[0]), held, hooks, len(held))
        unpack(hooks[0], body)
        unpack(hooks[1], load)
        return Motion(np.asarray(time, dtype=float), position, quaternion, held[:, : self.robot.chambers].copy())
