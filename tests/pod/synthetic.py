"""Snapshots of a body whose condensed energy is known in closed form: the fits must find it again."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softrl.artifacts.snapshots import Snapshots
from softrl.pod.symmetry import per_spin
from softrl.robots.robot import Robot

YOUNG_PA, MASS_KG = 1e6, 0.5
LAG_SHARE, LAG_RATIO = 0.2, 1.3  # of the viscosity lags, by so many times the stiffness damping
STROKE_N_PER_PA = 1e-3  # effective area of a chamber


def robot_with(chambers: int) -> Robot:
    """Return a robot with chambers at equal angles (from -90 degrees)."""
    return Robot(
        name=f"synthetic{chambers}",
        chamber_angle_deg=tuple(-90.0 - 360.0 * i / chambers for i in range(chambers)),
        chamber_radius_m=0.05,
        chamber_area_m2=1e-3,
        length_m=0.18,
        mass_kg=MASS_KG,
        pressure_min_pa=-2e4,
        pressure_max_pa=3.5e4,
        slew_pa_per_s=2e5,
        tip_force_max_n=2.0,
        axis="+z",
        output="tip_pose",
        command="pressure",
        command_to_pa=1.0,
        gravity_m_s2=(0.0, 0.0, -9.81),
    )


@dataclass(frozen=True)
class Law:
    """A polynomial energy of degree 4 with the symmetry of the chambers, in SI.

    With s_i = V_i / A the strokes: W = 1/2 k_v |s - J tip|^2 + 1/2 tip' K tip + q (tip' K tip)^2 + c s-cubed terms.
    """

    direction: np.ndarray
    bulge_n_per_m: float = 2e4
    bend_n_per_m: float = 800.0
    axial_n_per_m: float = 6e3
    cubic_n_per_m2: float = 2e3
    quartic_per_j: float = 0.3

    @property
    def chambers(self) -> int:
        return len(self.direction)

    @property
    def to_stroke(self) -> np.ndarray:
        """(n, 3) stroke of each chamber when the tip moves and nothing bulges."""
        return np.hstack([-0.5 * self.direction, np.ones((self.chambers, 1))])

    @property
    def tip_stiffness(self) -> np.ndarray:
        return np.diag([self.bend_n_per_m, self.bend_n_per_m, self.axial_n_per_m])

    @property
    def to_bulge(self) -> np.ndarray:
        """(n, n + 3) from z to what a chamber's stroke exceeds the tip's."""
        return np.hstack([np.eye(self.chambers) / STROKE_N_PER_PA, -self.to_stroke])

    def energy(self, z: np.ndarray) -> float:
        """Return W(z) in J."""
        bulge, tip = self.to_bulge @ z, z[self.chambers :]
        half = 0.5 * tip @ self.tip_stiffness @ tip
        stroke = z[: self.chambers] / STROKE_N_PER_PA
        return float(
            0.5 * self.bulge_n_per_m * bulge @ bulge
            + half
            + self.quartic_per_j * half**2
            + self.cubic_n_per_m2 * (stroke**3).sum()
        )

    def gradient(self, z: np.ndarray) -> np.ndarray:
        """Return the load (n + 3,) that holds z."""
        n, tip = self.chambers, z[self.chambers :]
        pull = self.tip_stiffness @ tip
        gradient = self.bulge_n_per_m * self.to_bulge.T @ (self.to_bulge @ z)
        gradient[n:] += pull * (1.0 + self.quartic_per_j * tip @ pull)
        gradient[:n] += 3.0 * self.cubic_n_per_m2 * z[:n] ** 2 / STROKE_N_PER_PA**3
        return gradient

    def hessian(self, z: np.ndarray) -> np.ndarray:
        """Return the inverse compliance (n + 3, n + 3)."""
        n, tip = self.chambers, z[self.chambers :]
        pull = self.tip_stiffness @ tip
        hessian = self.bulge_n_per_m * self.to_bulge.T @ self.to_bulge
        hessian[n:, n:] += self.tip_stiffness * (1.0 + self.quartic_per_j * tip @ pull)
        hessian[n:, n:] += 2.0 * self.quartic_per_j * np.outer(pull, pull)
        hessian[range(n), range(n)] += 6.0 * self.cubic_n_per_m2 * z[:n] / STROKE_N_PER_PA**3
        return hessian

    def compliance_slope(self, z: np.ndarray) -> np.ndarray:
        """Return d compliance / d load (n + 3, n + 3, n + 3); the Hessian is quadratic, so differences are exact."""
        compliance = np.linalg.inv(self.hessian(z))
        steps = np.diag(np.r_[np.full(self.chambers, 1e-6), np.full(3, 1e-3)])
        third = np.array([(self.hessian(z + e) - self.hessian(z - e)) / (2.0 * e.sum()) for e in steps])
        return -np.einsum("ai,bj,ck,ijk->abc", compliance, compliance, compliance, third)

    def equilibrium(self, load: np.ndarray) -> np.ndarray:
        """Return z at rest under ``load``, by Newton along a ramp."""
        z = np.zeros(len(load))
        for share in np.linspace(0.0, 1.0, 9)[1:]:
            for _ in range(30):
                step = np.linalg.solve(self.hessian(z), self.gradient(z) - share * load)
                z = z - step
                if np.abs(step[self.chambers :]).max() < 1e-15:
                    break
        return z

    def mass(self, z: np.ndarray) -> np.ndarray:
        """Return M (n + 3, n + 3), positive: R'R with R linear in the tip."""
        n = self.chambers
        root = np.diag(np.r_[np.full(n, 0.1 / STROKE_N_PER_PA), np.full(3, 0.4)])
        root[n:, n:] += np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0]) * 0.0 + np.eye(3) * 2.0 * z[n + 2]
        return root.T @ root

    def turning(self, z: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the force (n + 3,) of inertia at constant ``rate``, by differences that are exact for this mass."""
        steps = np.diag(np.r_[np.full(self.chambers, 1e-6), np.full(3, 1e-3)])
        slope = np.array([(self.mass(z + e) - self.mass(z - e)) / (2.0 * e.sum()) for e in steps])
        return 0.5 * np.einsum("jkl,k,l->j", slope, rate, rate) - np.einsum("kjl,k,l->j", slope, rate, rate)

    def centre_of_mass(self, z: np.ndarray) -> np.ndarray:
        """Return its displacement (3,) m: linear, and sinking as the body bends."""
        tip = z[self.chambers :]
        return 0.5 * tip - np.array([0.0, 0.0, 1.0]) * (tip[0] ** 2 + tip[1] ** 2)

    def rotation(self, z: np.ndarray) -> np.ndarray:
        """Return the rotation vector (3,) rad."""
        tip = z[self.chambers :]
        return 8.0 * np.array([-tip[1], tip[0], 0.0]) * (1.0 - 3.0 * tip[2])


def differences(map_of: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
    """Return the gradient (3, n + 3) of a map of degree 2 at ``z``: differences are exact."""
    steps = np.diag(np.r_[np.full(len(z) - 3, 1e-6), np.full(3, 1e-3)])
    return np.array([(map_of(z + e) - map_of(z - e)) / (2.0 * e.sum()) for e in steps]).T


def law_of(robot: Robot) -> Law:
    """Return the energy law of ``robot``."""
    return Law(robot.chamber_direction)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """Return w x y z of a rotation vector (3,)."""
    angle = np.linalg.norm(rotation)
    return np.r_[np.cos(angle / 2), np.sinc(angle / 2 / np.pi) / 2 * rotation]


def march(law: Law, loads: np.ndarray, dt: float, mass_damping: float, stiffness_damping: float) -> np.ndarray:
    """Return z (steps, n + 3) by implicit Euler in SI with mass, damping at the start of each step; from rest.

    The stiffness in the damping is the law's Hessian half a step ahead; a share of it lags.
    """
    z, v, u, path = np.zeros(loads.shape[1]), np.zeros(loads.shape[1]), np.zeros(loads.shape[1]), []
    hold = LAG_RATIO * stiffness_damping / (LAG_RATIO * stiffness_damping + dt)
    for load in loads:
        mass, stiffness = law.mass(z), law.hessian(z + 0.5 * dt * v)
        damping = mass_damping * mass + stiffness_damping * (1.0 - LAG_SHARE * hold) * stiffness
        pull = LAG_SHARE * stiffness_damping * hold * stiffness @ u
        load = load + law.turning(z, v)
        trial = z + dt * v
        for _ in range(40):
            residual = mass @ (trial - z - dt * v) / dt**2 + damping @ (trial - z) / dt + pull + law.gradient(trial) - load
            step = np.linalg.solve(law.hessian(trial) + mass / dt**2 + damping / dt, residual)
            trial = trial - step
            if np.abs(step[law.chambers :]).max() < 1e-15:
                break
        v, z = (trial - z) / dt, trial
        u = hold * u + (1.0 - hold) * v
        path.append(z)
    return np.array(path)


def synthetic_snapshots(robot: Robot, samples: int, seed: int, trajectories: int = 2, steps: int = 60) -> Snapshots:
    """Return snapshots of the law's body; displacements are a few shapes times functions of the tip."""
    rng, law, n = np.random.default_rng(seed), law_of(robot), robot.chambers
    force = rng.standard_normal((samples, 3))
    force *= robot.tip_force_max_n * rng.random((samples, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
    loads = np.hstack([rng.uniform(robot.pressure_min_pa, robot.pressure_max_pa, (samples, n)), force])
    z = np.array([law.equilibrium(load) for load in loads])
    compliance = np.array([np.linalg.inv(law.hessian(point)) for point in z])
    compliance = 0.5 * (compliance + compliance.transpose(0, 2, 1))
    turned = np.array([law.rotation(point) for point in z])
    masses, stiffness = np.array([law.mass(point) for point in z]), np.array([law.hessian(point) for point in z])
    nodes = np.stack([rng.uniform(-0.05, 0.05, 40), rng.uniform(-0.05, 0.05, 40), rng.uniform(0, 0.18, 40)], axis=1)
    tip = z[:, n:]
    height = nodes[:, 2] / 0.18
    shape = tip[:, None] * height[:, None] ** 2 + (tip**2 * 5.0)[:, None] * (height * (1.0 - height))[:, None]
    held = rng.uniform(0.5 * robot.pressure_min_pa, 0.8 * robot.pressure_max_pa, (trajectories, 3, n))
    path_load = np.zeros((trajectories, steps, n + 3))
    path_load[..., :n] = np.repeat(held, -(-steps // 3), axis=1)[:, :steps]
    dt, mass_damping, stiffness_damping = 0.01, 5.0, 0.01
    paths = np.array([march(law, load, dt, mass_damping, stiffness_damping) for load in path_load])
    turns = np.array([[quaternion(law.rotation(point)) for point in path] for path in paths])
    return Snapshots(
        loads=loads,
        coordinate=z,
        energy=np.array([law.energy(point) for point in z]),
        compliance=compliance,
        compliance_slope=np.array([law.compliance_slope(point) for point in z]),
        tangent_stiffness=compliance @ stiffness @ compliance,
        tangent_mass=compliance @ masses @ compliance,
        lag_stiffness=LAG_RATIO * LAG_SHARE * stiffness,
        lag_viscosity=LAG_RATIO**2 * LAG_SHARE * stiffness,
        lag_spin=np.zeros((samples, 3, n + 3)),
        centre_of_mass=np.array([law.centre_of_mass(point) for point in z]),
        centre_slope=np.array([differences(law.centre_of_mass, point) for point in z]) @ compliance,
        give=np.zeros((samples, 3, 3)),
        give_spin=np.zeros((samples, 3, 3)),
        give_mass=np.zeros((samples, 3, 3)),
        give_coupling=np.zeros((samples, 3, n + 3)),
        tip_spin=np.linalg.inv(per_spin(turned)) @ np.array([differences(law.rotation, point) for point in z]) @ compliance,
        tip_quaternion=np.array([quaternion(turn) for turn in turned]),
        displacement=shape.astype(np.float32),
        nodal_mass=np.full(40, MASS_KG / 40),
        trajectory_time=dt * np.arange(1, steps + 1),
        trajectory_load=path_load,
        trajectory_coordinate=paths,
        trajectory_quaternion=turns,
        trajectory_gravity_m_s2=np.zeros(3),
        rest_tip=np.array([0.0, 0.0, 0.18]),
        rest_volume=np.full(n, 1e-4),
        mass=MASS_KG,
        law="stable_neo_hookean",
        moduli_pa=(YOUNG_PA,),
        element_order=2,
        mean_dilatation=True,
        youngs_modulus_pa=YOUNG_PA,
        poisson=0.45,
        density_kg_m3=1000.0,
        rayleigh_mass_per_s=mass_damping,
        rayleigh_stiffness_s=stiffness_damping,
        failed=0,
        robot_name=robot.name,
    )
