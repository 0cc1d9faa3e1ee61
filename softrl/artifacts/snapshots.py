"""What the full model computed: equilibria with their tangents, and trajectories."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError

PER_SAMPLE = (
    "coordinate", "energy", "compliance", "tangent_stiffness", "tangent_mass", "moments", "moment_slope", "give", "give_spin",
    "inner_give", "inner_spin", "inner_mass", "inner_coupling", "inner_viscosity", "inner_drag", "viscosity_by_gravity",
    "layer_energy", "layer_slope", "layer_give", "layer_drop", "layer_spin", "tip_spin", "tip_quaternion", "displacement",
)  # fmt: skip


@dataclass(frozen=True)
class Snapshots(Artifact):
    """Static equilibria and dynamic trajectories of the full finite-element model.

    A load is ``(p_1 .. p_n, F_x, F_y, F_z)``: chamber gauge pressures in Pa and a force on the plate's
    centroid in N; its conjugate coordinate is ``(V_1 - V_1(0) .., tip - tip(0))`` in m^3 and m.

    Attributes
    ----------
    loads : (samples, n + 3) Pa and N
    coordinate : (samples, n + 3) m^3 and m
    energy : (samples,) J, elastic energy above rest
    compliance : (samples, n + 3, n + 3) d coordinate / d load
    tangent_stiffness : (samples, n + 3, n + 3) T' K T with T = dx / d load and K what stiffness-proportional
        damping multiplies
    tangent_mass : (samples, n + 3, n + 3) T' M T with T = dx / d load
    moments : (samples, a, 3) kg m, of the displacement, see ``fem.moments``; the first is mass times the centre's
    moment_slope : (samples, a, 3, n + 3) d moments / d load
    moment_gram : (a, a) kg, products of the moments' own polynomials
    give : (samples, 3, 3) kg s^2, change of mass times centre of mass by gravity, volumes and tip held
    give_spin : (samples, 3, 3) rad s^2/m, rotation of the plate by gravity, volumes and tip held
    inner_give, inner_mass, inner_viscosity : (samples, 6, 6), of the shapes by which the body gives to inertia and damping of
        its motion, see ``fem.weight``: twice their energy, mass, and what stiffness-proportional damping multiplies;
        inner_spin : (samples, 3, 6) rotation of the plate;  inner_coupling, inner_drag : (samples, 6, n + 3), mass and what
        damps with the motion by the loads
    viscosity_by_gravity : (samples, 3, n + 3, n + 3) change of ``tangent_stiffness`` by unit gravity along each axis, volumes
        and tip held
    layer_energy : (samples, layers) J, elastic energy of each layer of the wall, from below; layer_slope : (samples, layers,
        n + 3) its change with the load
    layer_give : (samples, layers, layers) J;  layer_drop, layer_spin : (samples, 3, layers) kg m and rad, how the body gives
        where layers are stiffer, volumes and tip held, see ``fem.layers``
    tip_spin : (samples, 3, n + 3) rotation of the plate by the loads, rad per Pa and N
    tip_quaternion : (samples, 4) w x y z of the plate relative to rest
    slopes : by the names of those of the arrays above whose change with the load is known, that change, the load first:
        (samples, n + 3, ...); that of the compliance is symmetric in all three
    displacement : (samples, nodes, 3) m, float32, on the mesh's corner nodes
    nodal_mass : (nodes,) kg on the same nodes
    trajectory_time : (steps,) s, common to all trajectories
    trajectory_load : (trajectories, steps, n + 3) Pa and N, held over the step that ends at that time
    trajectory_coordinate : (trajectories, steps, n + 3) m^3 and m
    trajectory_quaternion : (trajectories, steps, 4) w x y z
    trajectory_gravity_m_s2 : (3,) that acts in the trajectories, which begin at rest under it
    rest_tip : (3,) m
    rest_volume : (n,) m^3
    mass : kg
    law, moduli_pa, element_order, mean_dilatation, youngs_modulus_pa, poisson, density_kg_m3, rayleigh_mass_per_s,
        rayleigh_stiffness_s : the model's settings, see ``fem.stage``
    failed : number of sampled loads whose equilibrium was not found
    robot_name : the robot
    """

    schema: ClassVar[int] = 12
    stage: ClassVar[str] = "fem"

    loads: np.ndarray
    coordinate: np.ndarray
    energy: np.ndarray
    compliance: np.ndarray
    tangent_stiffness: np.ndarray
    tangent_mass: np.ndarray
    moments: np.ndarray
    moment_slope: np.ndarray
    moment_gram: np.ndarray
    give: np.ndarray
    give_spin: np.ndarray
    inner_give: np.ndarray
    inner_spin: np.ndarray
    inner_mass: np.ndarray
    inner_coupling: np.ndarray
    inner_viscosity: np.ndarray
    inner_drag: np.ndarray
    viscosity_by_gravity: np.ndarray
    layer_energy: np.ndarray
    layer_slope: np.ndarray
    layer_give: np.ndarray
    layer_drop: np.ndarray
    layer_spin: np.ndarray
    tip_spin: np.ndarray
    tip_quaternion: np.ndarray
    slopes: dict[str, np.ndarray]
    displacement: np.ndarray
    nodal_mass: np.ndarray
    trajectory_time: np.ndarray
    trajectory_load: np.ndarray
    trajectory_coordinate: np.ndarray
    trajectory_quaternion: np.ndarray
    trajectory_gravity_m_s2: np.ndarray
    rest_tip: np.ndarray
    rest_volume: np.ndarray
    mass: float
    law: str
    moduli_pa: tuple[float, ...]
    element_order: int
    mean_dilatation: bool
    youngs_modulus_pa: float
    poisson: float
    density_kg_m3: float
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    failed: int
    robot_name: str

    @property
    def chambers(self) -> int:
        """Number of pressure chambers."""
        return self.loads.shape[1] - 3

    def validate(self) -> None:
        """Check that every per-sample array has one row per load."""
        super().validate()
        rows = {name: getattr(self, name) for name in PER_SAMPLE} | {f"slopes/{name}": part for name, part in self.slopes.items()}
        for name, part in rows.items():
            if len(part) != len(self.loads):
                raise ArtifactError(f"Snapshots.{name} has {len(part)} rows for {len(self.loads)} loads")
