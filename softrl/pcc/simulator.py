"""Lumped body, one rod whose curvature changes evenly along it: needs no mesh, only a robot's few numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from softrl.core.errors import ConfigError, SolverError
from softrl.core.simulator import Hook, Motion
from softrl.effects.call import Calls, pack, unpack
from softrl.pcc.inertia import inertia_of
from softrl.pcc.kernel import run_kernel
from softrl.pcc.model import Model, fill_shape
from softrl.pcc.pose import tip_orientation, tip_position
from softrl.pcc.strains import maps_of, moving_of, strains_of, wall_of
from softrl.robots.robot import Robot

LENGTH = "length_scale"
TAPER = "stiffness_base_to_tip"
INEXTENSIBLE = 1e-5  # elongation that stands for none
QUASI_STATIC_S = 1e12  # one implicit step of this length is an equilibrium
_NONE = pack(())


class PccState(NamedTuple):
    """Coordinates (m,) and velocity (m,) 1/s, and the coordinates (m,) at rest, from which strains count.

    Bend to +x and +y in rad, elongation, and what the curvature loses from base to tip, of either, times the length; planar:
    bend and loss of curvature in the chamber's plane. Without a ``rest`` it is the equilibrium under gravity alone.
    """

    coordinates: np.ndarray
    velocity: np.ndarray
    rest: np.ndarray | None = None


@dataclass(frozen=True)
class PccSimulator:
    """One rod with linear stiffness, whose curvature changes evenly along it, implemented as a Simulator.

    Attributes
    ----------
    robot : chambers, geometry, mass, gravity; its axis must be +z
    bend_at_full_pressure_rad : bend under ``robot.pressure_max_pa`` in one chamber at stiffness scale 1
    elongation_at_full_pressure : elongation under ``robot.pressure_max_pa`` in all chambers at stiffness
        scale 1; 0 for a body that does not stretch, which has no axial stiffness to retune
    bending_stiffness_scale, axial_stiffness_scale : of the stiffnesses that follow from the two numbers above
    damping_s : damping over stiffness: the time constant with which a massless body settles
    mass_scale : of ``robot.mass_kg``
    stiffness_base_to_tip : bending stiffness at the base over that at the tip, between which it changes evenly
    length_scale : of ``robot.length_m``; not retuned, but a diagnosis sets it where the tip at rest tells another length
    end_mass_kg : how much of ``robot.mass_kg`` sits at the tip (an end plate, markers); the rest lies evenly along the body
    retune_taper : whether ``stiffness_base_to_tip`` is retuned with the others; a diagnosis tries that where nothing else fits

    Notes
    -----
    Without weight and force an even robot is an arc of constant curvature, as in the reviews of continuum robots (no equation
    number checked). A chamber at direction ``d`` and radius ``r`` elongates by ``e = epsilon - (r / L) b.d``, and its pressure
    does the work ``p A L de``, so that it bends the tip away from itself. Loads bend it more at the base than at the tip:
    curvature ``b + c (1 - 2 s)`` at the share ``s`` of the length, with elastic energy ``K (b^2 + c^2 / 3 + 2 u b.c / 3) / 2``
    where the bending stiffness is ``K (1 + u (1 - 2 s))``, larger at the base than at the tip: a body that tapers, or whose
    clamp gives, bends unevenly under pressure, too. Small bends of an even body under any loads across then move the tip as
    those of Euler and Bernoulli's rod do, exactly (``F L^3 / (3 E I)`` for a force at the tip), and its swing has the first
    frequency of that rod to 0.5 %, with a mass at its end or without. Of ``c``, first-order terms count, and its square along
    the axis. Inertia is that of an evenly loaded rod that is bent so, along the axis that of its first mode, and changes with the
    shape, see ``inertia``. The length at rest already includes the axial weight. A robot of one chamber that does not stretch, or
    reports its bend alone, bends in its plane only. Effects of the wall are evaluated at a chamber's mean strain, so that one
    which creeps or slips resists ``c`` as it does without; one that is stiffer does so by as much (``UNEVEN``).
    """

    robot: Robot
    bend_at_full_pressure_rad: float
    elongation_at_full_pressure: float
    bending_stiffness_scale: float
    axial_stiffness_scale: float
    damping_s: float
    mass_scale: float
    stiffness_base_to_tip: float = 1.0
    length_scale: float = 1.0
    end_mass_kg: float = 0.0
    retune_taper: bool = False

    def __post_init__(self) -> None:
        self.robot.check_upright("simulator pcc")
        if self.robot.pressure_max_pa <= 0.0:
            raise ConfigError(
                f"robot.pressure_max_pa={self.robot.pressure_max_pa:g} must be positive for simulator pcc"
            )
        if not self.elongation_at_full_pressure >= 0.0:
            raise ConfigError(
                f"simulator.elongation_at_full_pressure={self.elongation_at_full_pressure:g} must not be negative"
            )
        for name in ("bend_at_full_pressure_rad", TAPER, LENGTH, *self._tunable):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ConfigError(f"simulator.{name}={getattr(self, name):g} must be positive")
        if not 0.0 <= self.end_mass_kg < self.robot.mass_kg:
            raise ConfigError(
                f"simulator.end_mass_kg={self.end_mass_kg:g} must be a part of robot.mass_kg={self.robot.mass_kg:g}, 0 or more"
            )

    @property
    def _tunable(self) -> tuple[str, ...]:
        axial = ("axial_stiffness_scale",) if self.elongation_at_full_pressure > 0.0 and not self._planar else ()
        taper = (TAPER,) if self.retune_taper else ()
        return ("bending_stiffness_scale", *axial, "damping_s", "mass_scale", *taper)

    @property
    def _planar(self) -> bool:
        """Whether the body bends only, in the plane of its one chamber: it does not stretch, or nothing would show it."""
        return self.robot.chambers == 1 and (self.elongation_at_full_pressure == 0.0 or self.robot.output == "bend_angle")

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters; a body that does not stretch, or shows a bend only, has no axial stiffness."""
        return {name: getattr(self, name) for name in self._tunable}

    def with_parameters(self, **values: float) -> "PccSimulator":
        """Return a copy with some tunable parameters, its length, or its taper replaced."""
        unknown = set(values) - {LENGTH, TAPER, *self._tunable}
        if unknown:
            raise ConfigError(
                f"simulator pcc has no parameter {', '.join(sorted(unknown))}; it has {', '.join(self._tunable)}"
            )
        changed: dict[str, Any] = dict(values)
        return replace(self, **changed)

    @property
    def length_m(self) -> float:
        """Length at rest, m."""
        return self.length_scale * self.robot.length_m

    @property
    def stiffness(self) -> np.ndarray:
        """(3,) J: of b_x, b_y (per rad^2) and elongation."""
        r = self.robot
        bending = r.pressure_max_pa * r.chamber_area_m2 * r.chamber_radius_m / self.bend_at_full_pressure_rad
        elongation = max(self.elongation_at_full_pressure, INEXTENSIBLE)
        axial = r.chambers * r.pressure_max_pa * r.chamber_area_m2 * self.length_m / elongation
        return np.array([bending, bending, axial]) * [
            self.bending_stiffness_scale,
            self.bending_stiffness_scale,
            self.axial_stiffness_scale,
        ]

    @property
    def _uneven(self) -> float:
        """By what share of the mean the bending stiffness is larger at the base, and smaller at the tip."""
        return (self.stiffness_base_to_tip - 1.0) / (self.stiffness_base_to_tip + 1.0)

    @property
    def strain_map(self) -> np.ndarray:
        """(chambers, 3): chamber elongation per coordinate (b_x, b_y, epsilon)."""
        return strains_of(tuple(self.robot.chamber_angle_deg), self.robot.chamber_radius_m / self.length_m)

    @cached_property
    def _model(self) -> Model:
        """What the kernel reads, about the equilibrium under gravity alone."""
        return self._straight._replace(rest=self._equilibrium((_NONE, _NONE)))

    @cached_property
    def _straight(self) -> Model:
        """What the kernel reads, about the straight body."""
        r, length = self.robot, self.length_m
        plane, to_strain = maps_of(tuple(r.chamber_angle_deg), r.chamber_radius_m / length, self._planar)
        end = self.mass_scale * self.end_mass_kg
        mass, uneven = self.mass_scale * r.mass_kg - end, self._uneven
        bending, _, axial = self.stiffness
        stiffness = np.array([bending, bending, axial, bending / 3.0, bending / 3.0])
        if self._planar:
            stiffness = stiffness[[0, 3]]
        work = r.chamber_area_m2 * length  # of a pascal over a strain of 1
        elastic = stiffness[: to_strain.shape[1]]
        to_moving = moving_of(to_strain, elastic)
        to_elastic = np.ascontiguousarray(to_moving.T * elastic / work)
        gravity = np.array(r.gravity_m_s2, dtype=float)
        return Model(
            plane=plane,
            stiffness=stiffness,
            damping=self.damping_s * stiffness,
            inertia=inertia_of(length, mass, end),
            skewed=float(bending / 3.0 * uneven),
            skewed_damping=float(self.damping_s * bending / 3.0 * uneven),
            push=np.ascontiguousarray(work * to_strain.T),
            to_strain=to_strain,
            to_elastic=to_elastic,
            slope=np.sum(to_elastic * to_moving.T, axis=1),
            wall=wall_of(to_strain, elastic) / work,
            beside=np.diag(elastic) - work * to_strain.T @ to_elastic,
            rest=np.zeros(len(stiffness)),
            length=float(length),
            mass=float(mass),
            end=float(end),
            axial_weight=float((mass / 2.0 + end) * gravity[2] * length),
            gravity=gravity,
            order=(0.0,) * len(stiffness),
        )

    def _equilibrium(
        self, hooks: tuple[Calls, Calls], pressure: np.ndarray | None = None, tip_force: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the coordinates (m,) at rest under gravity, load effects, ``pressure`` (chambers,) and ``tip_force`` (3,)."""
        order = 2 if self._planar else 5
        loads_only = (_NONE, hooks[1])
        y = np.zeros(order)
        held = np.zeros((1, self.robot.chambers)) if pressure is None else np.atleast_2d(pressure).astype(float)
        self._run(
            y,
            np.zeros(order),
            QUASI_STATIC_S,
            held,
            np.zeros((1, 3)) if tip_force is None else np.atleast_2d(tip_force).astype(float),
            self._straight,
            loads_only,
        )
        return y

    def _run(
        self,
        y: np.ndarray,
        velocity: np.ndarray,
        dt_s: float,
        pressure: np.ndarray,
        tip_force: np.ndarray,
        model: Model,
        hooks: tuple[Calls, Calls],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance ``y`` and ``velocity`` in place; return positions (steps, 3) and quaternions (steps, 4)."""
        position, quaternion = np.empty((len(pressure), 3)), np.empty((len(pressure), 4))
        failed = run_kernel(y, velocity, dt_s, pressure, tip_force, model, hooks, position, quaternion)
        if failed > 0.01 * len(pressure) or not np.isfinite(y).all():
            raise SolverError(
                f"simulator pcc: {failed} of {len(pressure)} steps of {dt_s:g} s did not converge; "
                "try a smaller dt_s, a larger stiffness, or weaker effects"
            )
        return position, quaternion

    def equilibrium(self, pressure: np.ndarray, tip_force: np.ndarray | None = None) -> PccState:
        """Return the state at rest under ``pressure`` (chambers,) Pa, ``tip_force`` (3,) N and gravity."""
        y = self._equilibrium((_NONE, _NONE), np.asarray(pressure, dtype=float), tip_force)
        return PccState(y, np.zeros_like(y))

    def reset(self, rng: np.random.Generator | None = None) -> PccState:
        """Return the state at rest under zero pressure; ``rng`` is unused."""
        rest = self._model.rest.copy()
        return PccState(rest, np.zeros_like(rest))

    def at_rest(self, load: Sequence[Hook]) -> PccState:
        """Return the state at rest under gravity and ``load`` effects, whose states follow; strains count from there."""
        if not load:
            return self.reset()
        hooks = _NONE, pack(load)
        rest = self._equilibrium(hooks)
        unpack(hooks[1], load)
        return PccState(rest, np.zeros_like(rest), rest)

    def step(
        self,
        state: PccState,
        pressure: np.ndarray,
        dt_s: float,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> PccState:
        """Return the state after ``dt_s`` under ``pressure`` (chambers,) Pa and ``tip_force`` (3,) N.

        Several rows of both, (steps, chambers) and (steps, 3), are held for ``dt_s`` each. Strains that body effects see
        count from the state's own rest.
        """
        y, velocity = state.coordinates.copy(), state.velocity.copy()
        held = np.array(pressure, dtype=float).reshape(-1, self.robot.chambers)
        force = np.zeros((len(held), 3)) if tip_force is None else np.array(tip_force, dtype=float).reshape(-1, 3)
        hooks = pack(body), pack(load)
        model = self._model if state.rest is None else self._model._replace(rest=state.rest)
        self._run(y, velocity, float(dt_s), held, force, model, hooks)
        unpack(hooks[0], body)
        unpack(hooks[1], load)
        return PccState(y, velocity, state.rest)

    def observe(self, state: PccState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        position, quaternion = np.empty(3), np.empty(4)
        shape = np.empty(5)
        fill_shape(self._model, state.coordinates, shape)
        tip_position(shape, self.length_m, position)
        tip_orientation(shape, quaternion)
        return position, quaternion

    def simulate(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, chambers), each row held until its time.

        Rest is the equilibrium under gravity and the load effects; strains that body effects see count from
        there.
        """
        hooks = pack(body) if body else _NONE, pack(load) if load else _NONE
        model = self._straight._replace(rest=self._equilibrium(hooks)) if load else self._model
        y, velocity = model.rest.copy(), np.zeros_like(model.rest)
        held = np.ascontiguousarray(pressure, dtype=float)
        force = np.zeros((len(time), 3)) if tip_force is None else np.ascontiguousarray(tip_force, dtype=float)
        position, quaternion = self._run(y, velocity, float(time[1] - time[0]), held, force, model, hooks)
        unpack(hooks[0], body)
        unpack(hooks[1], load)
        return Motion(np.asarray(time, dtype=float), position, quaternion, held)
