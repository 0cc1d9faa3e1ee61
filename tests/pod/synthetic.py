"""Snapshots of a body whose condensed energy is known in closed form: the fits must find it again."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softrl.artifacts.snapshots import Snapshots
from softrl.pod.fitting.equilibria import per_spin, twice
from softrl.robots.robot import Robot

YOUNG_PA, MASS_KG = 1e6, 0.5
STROKE_N_PER_PA = 1e-3  # effective area of a chamber
GIVE = np.diag([8e-5, 7e-5, 4e-5, 5e-5, 6e-5, 3e-5])  # kg s^2, the inside; with mass and viscosity, and shared with the tip
LAYERS = np.array([0.5, 0.3, 0.2])  # share of each in the energy: they bear one load in series
GIVE_MASS, GIVE_COUPLING = 2e-8 * np.eye(6), 0.3 * GIVE.reshape(6, 2, 3).sum(axis=1)
GIVE_DRAG = np.tile(0.02 * np.eye(3), (2, 1))


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

    def answers(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Return by the names of ``Snapshots`` how the equilibrium z answers its loads and its weight."""
        n, stiffness = self.chambers, self.hessian(z)
        compliance = np.linalg.inv(stiffness)
        tip = twice(compliance[n:, n:])  # what the inside gives is alike by the tip's acceleration, and told by that of its force
        return {
            "compliance": 0.5 * (compliance + compliance.T),
            "tangent_stiffness": compliance @ self.viscosity(z) @ compliance,
            "tangent_mass": compliance @ self.mass(z) @ compliance,
            "give": GIVE[:3, :3],
            "give_spin": np.zeros((3, 3)),
            "inner_give": tip @ GIVE @ tip,
            "inner_spin": np.zeros((3, 6)),
            "inner_mass": tip @ GIVE_MASS @ tip,
            "inner_coupling": tip @ np.hstack([np.zeros((6, n)), GIVE_COUPLING]) @ compliance,
            "inner_viscosity": tip @ GIVE @ tip,
            "inner_drag": tip @ np.hstack([np.zeros((6, n)), GIVE_DRAG]) @ compliance,
        }

    def slopes(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Return how ``answers`` change with each load."""
        return {name: self.slopes_of(lambda at, key=name: self.answers(at)[key], z) for name in self.answers(z)}

    def slopes_of(self, function: Callable[[np.ndarray], np.ndarray], z: np.ndarray) -> np.ndarray:
        """Return how ``function`` of z changes with each load, by differences."""
        steps = np.diag(np.r_[np.full(self.chambers, 1e-8), np.full(3, 1e-5)])
        rates = [(function(z + step) - function(z - step)) / (2.0 * step.sum()) for step in steps]
        return np.tensordot(np.linalg.inv(self.hessian(z)), np.array(rates), axes=(0, 0))

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

    def amplitudes(self, z: np.ndarray) -> np.ndarray:
        """Return how far the body's masses are from rest (n + 6,) kg^0.5 m: its centre, and what follows z in proportion."""
        own = np.r_[np.full(self.chambers, 0.1 / STROKE_N_PER_PA), np.full(3, 0.3)]
        return np.r_[own * z, MASS_KG**0.5 * self.centre_of_mass(z)]

    def lead(self, z: np.ndarray) -> np.ndarray:
        """Return the gradient (n + 6, n + 3) of the amplitudes: differences are exact, they are of degree 2."""
        steps = np.diag(np.r_[np.full(self.chambers, 1e-6), np.full(3, 1e-3)])
        return np.array([(self.amplitudes(z + e) - self.amplitudes(z - e)) / (2.0 * e.sum()) for e in steps]).T

    def mass(self, z: np.ndarray) -> np.ndarray:
        """Return M (n + 3, n + 3)."""
        return self.lead(z).T @ self.lead(z)

    def viscosity(self, z: np.ndarray) -> np.ndarray:
        """Return what stiffness-proportional damping multiplies (n + 3, n + 3): more of it where the body is longer."""
        return (1.0 + 4.0 * z[-1]) ** 2 * self.hessian(np.zeros_like(z))

    def half_slope(self, metric: Callable[[np.ndarray], np.ndarray], start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return half the derivative by ``end`` (n + 3,) of ``by' metric by``, the metric half way, by differences."""

        def half_square(end: np.ndarray) -> float:
            by = end - start
            return float(0.5 * by @ metric(0.5 * (start + end)) @ by)

        steps = np.diag(np.r_[np.full(self.chambers, 1e-7), np.full(3, 1e-4)])
        return np.array([(half_square(end + e) - half_square(end - e)) / (2.0 * e.sum()) for e in steps])

    def centre_of_mass(self, z: np.ndarray) -> np.ndarray:
        """Return its displacement (3,) m: linear, and sinking as the body bends."""
        tip = z[self.chambers :]
        return 0.5 * tip - np.array([0.0, 0.0, 1.0]) * (tip[0] ** 2 + tip[1] ** 2)

    def rotation(self, z: np.ndarray) -> np.ndarray:
        """Return the rotation vector (3,) rad."""
        tip = z[self.chambers :]
        return 8.0 * np.array([-tip[1], tip[0], 0.0]) * (1.0 - 3.0 * tip[2])

    def layers(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Return by the names of ``Snapshots`` what its layers have to do with z."""
        energy, sway = self.energy(z), np.array([1.0, -1.0, 0.0])
        return {
            "layer_energy": energy * LAYERS,
            "layer_slope": np.outer(LAYERS, self.gradient(z) @ np.linalg.inv(self.hessian(z))),
            "layer_give": 2.0 * energy * (np.diag(LAYERS) - np.outer(LAYERS, LAYERS)),
            "layer_drop": 0.4 * MASS_KG * np.outer(self.centre_of_mass(z), sway),
            "layer_spin": 0.4 * np.outer(self.rotation(z), sway),
        }


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
    """Return z (steps, n + 3) by implicit Euler in SI, from rest, the inside's six coordinates solved for with the rest.

    Forces of inertia are those of the amplitudes' differences; that of viscosity is the derivative of a squared distance.
    """
    r = loads.shape[1]
    path = [np.zeros(r + 6)] * 2
    for load in loads:
        (before, now), trial = path[-2:], 2.0 * path[-1] - path[-2]
        mass, viscosity = (joint(m, c, g) for m, c, g in (
            (law.mass(now[:r]), GIVE_COUPLING, GIVE_MASS), (law.viscosity(now[:r]), GIVE_DRAG, GIVE),
        ))  # fmt: skip
        damping = mass_damping / dt * mass + stiffness_damping / dt * viscosity
        for _ in range(60):
            strain = law.half_slope(law.viscosity, now[:r], trial[:r])
            at, start, behind = (law.amplitudes(z[:r]) for z in (trial, now, before))
            pushed = (at - 2.0 * start + behind) / dt**2 + mass_damping / dt * (at - start)
            beside = joint(np.zeros((r, r)), GIVE_COUPLING, GIVE_MASS) @ (trial - 2.0 * now + before) / dt**2
            beside += mass_damping / dt * joint(np.zeros((r, r)), GIVE_COUPLING, GIVE_MASS) @ (trial - now)
            beside += stiffness_damping / dt * joint(np.zeros((r, r)), GIVE_DRAG, GIVE) @ (trial - now)
            force = law.lead(trial[:r]).T @ pushed + stiffness_damping / dt * strain
            residual = beside + np.r_[force + law.gradient(trial[:r]) - load, GIVE @ trial[r:]]
            step = np.linalg.solve(joint(law.hessian(trial[:r]), 0.0 * GIVE_DRAG, GIVE) + mass / dt**2 + damping, residual)
            trial = trial - step
            if np.abs(step[law.chambers : r]).max() < 1e-10:
                break
        path.append(trial)
    return np.array(path[2:])[:, :r]


def joint(matrix: np.ndarray, with_tip: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return a matrix (n + 9, n + 9) of the coordinates and the inside, which shares (6, 3) with the tip alone."""
    across = np.vstack([np.zeros((len(matrix) - 3, 6)), with_tip.T])
    return np.block([[matrix, across], [across.T, own]])


def synthetic_snapshots(robot: Robot, samples: int, seed: int, trajectories: int = 2, steps: int = 60) -> Snapshots:
    """Return snapshots of the law's body; displacements are a few shapes times functions of the tip."""
    rng, law, n = np.random.default_rng(seed), law_of(robot), robot.chambers
    force = rng.standard_normal((samples, 3))
    force *= robot.tip_force_max_n * rng.random((samples, 1)) / np.linalg.norm(force, axis=1, keepdims=True)
    loads = np.hstack([rng.uniform(robot.pressure_min_pa, robot.pressure_max_pa, (samples, n)), force])
    z = np.array([law.equilibrium(load) for load in loads])
    answers, slopes = ({name: np.array([row[name] for row in rows]) for name in rows[0]}
                       for rows in ([law.answers(point) for point in z], [law.slopes(point) for point in z]))
    parts = [law.layers(point) for point in z]
    compliance, turned = answers["compliance"], np.array([law.rotation(point) for point in z])
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
        **answers,
        **{name: np.array([part[name] for part in parts]) for name in parts[0]},
        slopes=slopes,
        moments=MASS_KG * np.array([law.centre_of_mass(point) for point in z])[:, None],
        moment_slope=MASS_KG * (np.array([differences(law.centre_of_mass, point) for point in z]) @ compliance)[:, None],
        moment_gram=np.full((1, 1), MASS_KG),
        tip_spin=np.linalg.inv(per_spin(turned)) @ np.array([differences(law.rotation, point) for point in z]) @ compliance,
        tip_quaternion=np.array([quaternion(turn) for turn in turned]),
        displacement=shape.astype(np.float32),
        nodal_mass=np.full(40, MASS_KG / 40),
        viscosity_by_gravity=np.zeros((samples, 3, n + 3, n + 3)),
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
