"""POD Galerkin with ECSW as a Simulator: the paper's reduction, beside the energy ROM under the same interface."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots
from softrl.core import fingerprint
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.resume import Kept, pack, unpack
from softrl.core.simulator import Hook, Motion
from softrl.fem.damping import viscous, viscous_moduli
from softrl.fem.law import STRESS, TANGENT, VISCOUS
from softrl.fem.material import Material, material_of
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import step_program
from softrl.pod.galerkin.model import GalerkinBody, build_body, elastic, full_displacements, moving_displacements
from softrl.robots.robot import Robot

TUNABLE = ("youngs_modulus_scale", "damping_scale", "mass_scale")
MODEL = ("law", "moduli_pa", "poisson", "element_order", "mean_dilatation", "rayleigh_mass_per_s", "rayleigh_stiffness_s")
NEWTON = NewtonSettings(tolerance_m=1e-7, max_iterations=40, reuse_below=0.5)  # of the full model in training
QUASI_STATIC_S, LOAD_STEPS = 1e6, 4
TOLERANCE_M, ITERATIONS, PATIENCE = 1e-7, 60, 6  # a matrix is made anew after so many steps with an old one


class GalerkinState(NamedTuple):
    """Amplitudes (r,) kg^0.5 m and their velocity; ``coordinates`` (n + 3,) volumes and tip from rest, m^3 and m."""

    amplitude: np.ndarray
    velocity: np.ndarray
    coordinates: np.ndarray


@dataclass(frozen=True)
class GalerkinSimulator:
    """The full model's equations on POD modes, with weight; eqs. 2-4 of [Hong 2025].

    Attributes
    ----------
    robot, mesh, snapshots : of the same robot; material, elements and damping are those of the snapshots
    modes : at most so many
    training_snapshots : equilibria that the basis and ECSW see
    training_motion_s, hold_s, dt_s : a motion of the full model that they see too; without it nothing can lag
    ecsw_tolerance, ecsw_elements : error of the sampled work at which ECSW ends, and elements at most
    seed : of the training motion
    youngs_modulus_scale, damping_scale, mass_scale : factors as in the energy ROM

    Notes
    -----
    The body is built when it is first needed, which takes a minute or two of the full model, and is kept under the
    working directory. Effects inside the body are refused; the energy ROM takes them.
    """

    backward: ClassVar[bool] = True

    robot: Robot
    mesh: Mesh
    snapshots: Snapshots
    modes: int
    training_snapshots: int
    training_motion_s: float
    hold_s: float
    dt_s: float
    ecsw_tolerance: float
    ecsw_elements: int
    seed: int
    youngs_modulus_scale: float
    damping_scale: float
    mass_scale: float

    def __post_init__(self) -> None:
        for name in ("modes", "training_snapshots", "hold_s", "dt_s", "ecsw_tolerance", "ecsw_elements"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"simulator.{name}={getattr(self, name):g} must be positive")
        for name in TUNABLE:
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0 or (value == 0 and name != "damping_scale"):
                raise ConfigError(f"simulator.{name}={value:g} must be positive")
        if not self.mesh.chambers == self.snapshots.chambers == self.robot.chambers:
            raise ArtifactError(
                f"the mesh has {self.mesh.chambers} cavities, the Snapshots {self.snapshots.chambers} chambers, robot "
                f"{self.robot.name} {self.robot.chambers}; run stage=mesh and stage=fem for this robot"
            )
        if len(self.mesh.points) != self.snapshots.displacement.shape[1]:
            raise ArtifactError(
                f"the Snapshots have {self.snapshots.displacement.shape[1]} nodes, the mesh {len(self.mesh.points)}; "
                "take the mesh that stage=fem had"
            )

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters."""
        return {name: getattr(self, name) for name in TUNABLE}

    def with_parameters(self, **values: float) -> "GalerkinSimulator":
        """Return a copy with some tunable parameters replaced; it shares the body, which does not depend on them."""
        unknown = set(values) - set(TUNABLE)
        if unknown:
            raise ConfigError(
                f"simulator galerkin has no parameter {', '.join(sorted(unknown))}; it has {', '.join(TUNABLE)}"
            )
        changed: dict[str, Any] = dict(values)
        made = replace(self, **changed)
        if "body" in self.__dict__:
            made.__dict__["body"] = self.body
        return made

    @cached_property
    def body(self) -> GalerkinBody:
        """The reduced equations, built or read back."""
        if not self.is_built:
            self._kept.save("body", pack(self._build()))
        return unpack(GalerkinBody, self._kept.load("body"))  # type: ignore[no-any-return]

    @property
    def is_built(self) -> bool:
        """Whether the body was built before, and is read back."""
        return "body" in self._kept

    @cached_property
    def _kept(self) -> Kept:
        arrays = {f"mesh.{f.name}": getattr(self.mesh, f.name) for f in fields(self.mesh)}
        arrays |= {f"snapshots.{name}": getattr(self.snapshots, name) for name in ("loads", "displacement")}
        skip = (*TUNABLE, "mesh", "snapshots", "robot")
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in skip}
        settings |= {name: getattr(self.snapshots, name) for name in MODEL}
        code = fingerprint.of_code(__name__)
        return Kept("galerkin", fingerprint.of_values([settings, asdict(self.robot), fingerprint.of_arrays(arrays), code]))

    def _build(self) -> GalerkinBody:
        shots = self.snapshots
        model = FemModel(
            self.mesh, self._material, self.robot.mass_kg / self.mesh.volume(), shots.rayleigh_mass_per_s,
            shots.rayleigh_stiffness_s, NEWTON, element_order=shots.element_order, mean_dilatation=shots.mean_dilatation,
        )  # fmt: skip
        chosen = np.unique(np.linspace(0, len(shots.loads) - 1, min(self.training_snapshots, len(shots.loads))).astype(int))
        seen = [full_displacements(model, shots.loads[chosen], shots.displacement[chosen])]
        if self.training_motion_s > 0:
            clock = np.arange(1, round(self.training_motion_s / self.dt_s) + 1) * self.dt_s
            program = step_program(self.robot, clock, self.hold_s, np.random.default_rng([self.seed, 9001]))
            seen.append(moving_displacements(model, program, self.dt_s))
        displacement = np.concatenate(seen)
        return build_body(
            model, self._material, displacement, self.modes, self.ecsw_tolerance, self.ecsw_elements, len(displacement)
        )

    @cached_property
    def _material(self) -> Material:
        return material_of(self.snapshots.law, self.snapshots.moduli_pa, self.snapshots.poisson)

    @cached_property
    def _rest(self) -> np.ndarray:
        return self._settle(np.zeros(self.robot.chambers + 3))

    def _settle(self, load: np.ndarray) -> np.ndarray:
        """Return the amplitudes at rest under ``load`` (n + 3,) and weight."""
        q = np.zeros(self.body.slope.shape[3])
        for share in np.arange(1, LOAD_STEPS + 1) / LOAD_STEPS:
            q = self._solve(q, np.zeros_like(q), share * load, QUASI_STATIC_S, share)
        return q

    def _elastic(self, q: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
        body, r = self.body, len(q)
        gradient, hessian = np.zeros(r), np.zeros((r, r))
        energy = elastic(
            type(self._material).kernel, body.law_parameters, body.bulk_pa, body.slope, body.weight, q, order, gradient,
            hessian,
        )  # fmt: skip
        if not np.isfinite(energy):
            raise SolverError("simulator galerkin: the material's law ends at this state; use smaller loads or steps")
        return self.youngs_modulus_scale * gradient, self.youngs_modulus_scale * hessian

    def _viscous(self, q: np.ndarray) -> np.ndarray:
        """Return what stiffness-proportional damping multiplies (r, r), as the full model has it."""
        body, r = self.body, len(q)
        hessian = np.zeros((r, r))
        moduli = viscous_moduli(self._material, mean_volume=body.bulk_pa > 0.0)
        elastic(viscous, *moduli, body.slope, body.weight, q, VISCOUS, np.zeros(r), hessian)
        return self.youngs_modulus_scale * hessian

    def _outer(self, q: np.ndarray, load: np.ndarray, weight: float) -> np.ndarray:
        """Return the force (r,) of pressures, tip force and weight."""
        body, n = self.body, self.robot.chambers
        swell = body.volume_slope + body.volume_bend @ q + 0.5 * (body.volume_twist @ q) @ q
        pull = weight * self.mass_scale * body.mass * np.asarray(self.robot.gravity_m_s2) @ body.centre_of_mass
        return np.asarray(load[:n] @ swell + load[n:] @ body.tip + pull)

    def _solve(
        self, before: np.ndarray, velocity: np.ndarray, load: np.ndarray, dt_s: float, weight: float = 1.0
    ) -> np.ndarray:
        """Return the amplitudes ``dt_s`` later by implicit Euler, as ``fem.model.FemModel.step`` does it.

        Raises
        ------
        SolverError
            If Newton's method does not converge.
        """
        body, n, unit = self.body, self.robot.chambers, np.eye(len(before))
        mass, damp = self.mass_scale / dt_s**2, self.damping_scale / dt_s
        gradient, own = self._elastic(before, TANGENT)
        drag = damp * self.snapshots.rayleigh_mass_per_s * self.mass_scale * unit
        if self.snapshots.rayleigh_stiffness_s > 0 and self.damping_scale > 0:
            drag += damp * self.snapshots.rayleigh_stiffness_s * self._viscous(before + 0.5 * dt_s * velocity)
        flight, q, factors, age = before + dt_s * velocity, before.copy(), None, 0
        for _ in range(ITERATIONS):
            if factors is None or age >= PATIENCE:
                if factors is not None:
                    gradient, own = self._elastic(q, TANGENT)
                swelling = np.einsum("c,cij->ij", load[:n], body.volume_bend + body.volume_twist @ q)
                factors, age = _factorise(own + mass * unit + drag - swelling), 0
            residual = gradient + mass * (q - flight) + drag @ (q - before) - self._outer(q, load, weight)
            change = cho_solve(factors, residual)
            q, age = q - change, age + 1
            if body.reach * float(np.abs(change).max()) < TOLERANCE_M:
                return q
            gradient, _ = self._elastic(q, STRESS)
        raise SolverError(
            f"simulator galerkin: a step of {dt_s:g} s did not converge in {ITERATIONS} iterations; try a smaller step"
        )

    def _state(self, amplitude: np.ndarray, velocity: np.ndarray) -> GalerkinState:
        body, q = self.body, amplitude
        bend, twist = 0.5 * (body.volume_bend @ q) @ q, ((body.volume_twist @ q) @ q) @ q / 6.0
        return GalerkinState(q, velocity, np.r_[body.volume_slope @ q + bend + twist, body.tip @ q])

    def equilibrium(self, pressure: np.ndarray) -> GalerkinState:
        """Return the state at rest under ``pressure`` (n,) Pa and weight."""
        q = self._settle(np.r_[np.asarray(pressure, dtype=float), np.zeros(3)])
        return self._state(q, np.zeros_like(q))

    def reset(self, rng: np.random.Generator | None = None) -> GalerkinState:
        """Return the state at rest under zero pressure and weight; ``rng`` is unused."""
        return self._state(self._rest.copy(), np.zeros_like(self._rest))

    def step(
        self, state: GalerkinState, pressure: np.ndarray, dt_s: float, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> GalerkinState:
        """Return the state after ``dt_s`` under ``pressure`` (n,) Pa and ``tip_force`` (3,) N."""
        _refuse(body, load)
        force = np.zeros(3) if tip_force is None else np.asarray(tip_force, dtype=float)
        held = np.r_[np.asarray(pressure, dtype=float), force]
        q = self._solve(state.amplitude, state.velocity, held, float(dt_s))
        return self._state(q, (q - state.amplitude) / dt_s)

    def observe(self, state: GalerkinState) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z, the rotation that fits the plate's nodes best."""
        moment = self.body.plate[0] + np.tensordot(state.amplitude, self.body.plate[1:], axes=1)
        left, _, right = np.linalg.svd(moment)
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        quaternion = Rotation.from_matrix(turn).as_quat(canonical=True, scalar_first=True)
        return self.body.rest_tip + self.body.tip @ state.amplitude, quaternion

    def simulate(
        self, time: np.ndarray, pressure: np.ndarray, tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (), load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, n), each row held until its time."""
        _refuse(body, load)
        dt_s, state, poses = float(time[1] - time[0]), self.reset(), []
        for k, row in enumerate(pressure):
            state = self.step(state, row, dt_s, None if tip_force is None else tip_force[k])
            poses.append(self.observe(state))
        position, quaternion = (np.stack(values) for values in zip(*poses, strict=True))
        return Motion(np.asarray(time, dtype=float), position, quaternion, np.array(pressure, dtype=float))


def _factorise(matrix: np.ndarray) -> Any:
    """Return the Cholesky factors, of a shifted matrix where it is not positive."""
    shift, scale = 0.0, float(np.abs(np.diag(matrix)).max())
    while shift < 1e3:
        try:
            return cho_factor(matrix + shift * scale * np.eye(len(matrix)))
        except LinAlgError:
            shift = max(10.0 * shift, 1e-6)
    raise SolverError("simulator galerkin: the tangent is not finite; use smaller loads or steps")


def _refuse(body: Sequence[Hook], load: Sequence[Hook]) -> None:
    if body or load:
        raise ConfigError(
            "simulator=galerkin takes no effects at the sites body and load; choose simulator=rom, or effects at valve, "
            "chamber and sensor"
        )
