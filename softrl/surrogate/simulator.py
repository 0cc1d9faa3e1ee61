"""The surrogate as a body: pressures to commands, and the chain in PyBullet that follows them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError
from softrl.core.simulator import Hook, Motion
from softrl.robots.robot import Robot
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.world import Rayleigh, SurrogateState, World


@dataclass(frozen=True)
class SurrogateSimulator:
    """The surrogate as a body: pressure in, f_SP gives the joints' targets, PyBullet moves the links.

    Attributes
    ----------
    robot, surrogate : of the same name
    youngs_modulus_scale : softer or stiffer body: pressures and weight bend it the inverse of this, springs yield likewise
    damping_scale : of the full model's Rayleigh damping, which the joints have by their inertia and stiffness
    mass_scale : of the links' mass and weight

    Notes
    -----
    The targets follow the pressure at once, the links follow the targets. Effects that act inside a body's equations of
    motion need its strains, which a chain of rigid links does not have: they are refused.
    """

    robot: Robot
    surrogate: Surrogate
    youngs_modulus_scale: float
    damping_scale: float
    mass_scale: float
    _maps: PressureToJoints = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.surrogate.require_robot(self.robot.name, self.robot.gravity_m_s2)
        for name, value in self.parameters.items():
            if not (np.isfinite(value) and value > 0.0):
                raise ConfigError(f"simulator.{name}={value:g} must be positive")
        object.__setattr__(self, "_maps", PressureToJoints(self.surrogate))

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters."""
        return {n: getattr(self, n) for n in ("youngs_modulus_scale", "damping_scale", "mass_scale")}

    def with_parameters(self, **values: float) -> "SurrogateSimulator":
        """Return a copy with some tunable parameters replaced."""
        unknown = set(values) - set(self.parameters)
        if unknown:
            raise ConfigError(
                f"simulator surrogate has no parameter {', '.join(sorted(unknown))}; it has {', '.join(self.parameters)}"
            )
        return replace(self, **values)

    @cached_property
    def world(self) -> World:
        """The PyBullet server, started when first needed."""
        s, scale = self.surrogate, self.damping_scale
        damping = Rayleigh(scale * s.rayleigh_mass_per_s, scale * s.rayleigh_stiffness_s)
        return World(s, self.youngs_modulus_scale, damping, self.mass_scale)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "world"}

    def joint_targets(self, pressure: np.ndarray) -> np.ndarray:
        """Return theta (B, 3) that the springs pull to under ``pressure`` (B, n) Pa."""
        return self._maps.joints(np.atleast_2d(pressure) / self.youngs_modulus_scale)

    def reset(self, rng: np.random.Generator | None = None) -> SurrogateState:
        """Return the state at rest under zero pressure; ``rng`` is unused."""
        return self.world.at_rest(self.joint_targets(np.zeros(self.robot.chambers))[0])

    def step(
        self,
        state: SurrogateState,
        pressure: np.ndarray,
        dt_s: float,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> SurrogateState:
        """Return the state after ``dt_s`` under ``pressure`` (chambers,) Pa and ``tip_force`` (3,) N."""
        _refuse(body, load)
        return self.world.advance(state, self.joint_targets(pressure)[0], dt_s, tip_force)

    def observe(self, state: SurrogateState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        return self.world.pose(state)

    def simulate(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, chambers), each row held until its time."""
        _refuse(body, load)
        dt_s, state = float(time[1] - time[0]), self.reset()
        position, quaternion = np.empty((len(time), 3)), np.empty((len(time), 4))
        targets = self.joint_targets(pressure)
        for k, theta in enumerate(targets):
            state = self.world.advance(state, theta, dt_s, None if tip_force is None else tip_force[k])
            position[k], quaternion[k] = self.world.pose(state)
        return Motion(np.asarray(time, dtype=float), position, quaternion, np.array(pressure, dtype=float))


def _refuse(body: Sequence[Hook], load: Sequence[Hook]) -> None:
    if body or load:
        raise ConfigError(
            "simulator=surrogate takes no effects at the sites body and load: rigid links have no strains; "
            "choose simulator=rom or simulator=pcc, or effects at valve, chamber and sensor"
        )
