"""The reduced model: POD modes of the displacement, and the condensed energy that moves the body."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError

SHAPES = 6  # by which the inside gives: three to inertia, three to damping
TRIANGLE = SHAPES * (SHAPES + 1) // 2


@dataclass(frozen=True)
class ReducedModel(Artifact):
    """A body with ``n`` chambers in ``r = n + 3`` coordinates ``z = (V - V_rest, tip - tip_rest)``, m^3 and m.

    Rest is the stress-free shape without weight. All maps are polynomials of ``y`` with ``z = frame y``; the samples
    lie in the ball ``|y| <= 1``. Coefficients follow the monomials of ``r`` variables ordered by degree.

    Attributes
    ----------
    frame : (r, r) m^3 and m, z per y
    energy : (monomials,) J, elastic energy W; none of degree 0 and 1
    amplitudes : (k, monomials) kg^0.5 m, of modes of the displacement that are orthonormal in the mass, zero at rest; their
        gradient A makes the mass ``A'A`` in y
    stiffness_root, stiffness_factor : (r (r + 1) / 2, monomials), the upper triangle of a symmetric S, and a lower triangle
        L (r, r) (N m)^0.5, of ``L S'S L'``, which is T' K T in y, what stiffness-proportional damping multiplies
    stiffness_root_by_gravity : (3 r (r + 1) / 2, monomials) s^2/m, change of ``stiffness_root`` by unit gravity along each
        axis, to which the body gives
    centre_of_mass : (3, monomials) m, displacement of the centre of mass
    rotation : (3, monomials) rad, rotation vector of the tip relative to rest
    give : (9, monomials) kg^0.5 s, rows of R with R' R the change of mass times centre of mass by gravity, volumes and tip
        held
    give_rotation : (9, monomials) rad s^2/m, turn of the tip by gravity, volumes and tip held
    inner_give : (21, monomials) kg^0.5 s, upper triangle R with R' R twice the energy of the six shapes by which the body gives
        to inertia and damping of a motion that tip forces bring about, by 1 m/s^2 and ``fem.weight.PACE_S`` times that of the
        tip;  inner_rotation : (18, monomials) rad s^2/m, turn of the tip by them
    inner_root : (6 r + 21, monomials) kg^0.5 s^2, A (r, 6) and the upper triangle B (6, 6) of the joint mass
        [R A; 0 B]'[R A; 0 B] of y and these shapes, R'R the mass, R upper triangular
    drag_root : (6 r + 21, monomials) (N/m)^0.5 s^2, likewise of the viscosity, R = S L'
    layer_energy : (layers, monomials) J, what each layer of the wall stores, from below; zero at rest
    layer_give : (layers (layers + 1) / 2, monomials) J, upper triangle;  layer_drop : (3 layers, monomials) kg m, for each axis
        all layers;  layer_spin : (3 layers, monomials) rad, likewise: how the body gives where layers are stiffer, see
        ``pod.step.layers``
    rest_tip : (3,) m;  rest_volume : (n,) m^3;  mass : kg
    gravity_m_s2 : (3,) in the base frame, acting unless another is given
    pressure_min_pa, pressure_max_pa : the robot's limits
    load_low, load_high : (r,) Pa and N, range of the sampled loads
    rayleigh_mass_per_s, rayleigh_stiffness_s, youngs_modulus_pa : of the full model
    symmetry : the robot's symmetries used in the fit of the energy: none or all
    modes : (modes, nodes, 3) float32, orthonormal in the nodal masses, kg^-0.5
    singular_values : (samples,) kg^0.5 m, of the mass-weighted snapshots
    robot_name : the robot

    Notes
    -----
    ``dW/dz`` is the load (Pa, N) that holds ``z``; equations of motion ``M z'' + D z' + dW/dz = load`` with
    ``D = rayleigh_mass M + rayleigh_stiffness B``, B of ``stiffness_root``; beside them moves what the inside gives.
    """

    schema: ClassVar[int] = 12
    stage: ClassVar[str] = "pod"

    frame: np.ndarray
    energy: np.ndarray
    amplitudes: np.ndarray
    stiffness_root: np.ndarray
    stiffness_factor: np.ndarray
    stiffness_root_by_gravity: np.ndarray
    centre_of_mass: np.ndarray
    rotation: np.ndarray
    give: np.ndarray
    give_rotation: np.ndarray
    inner_give: np.ndarray
    inner_rotation: np.ndarray
    inner_root: np.ndarray
    drag_root: np.ndarray
    layer_energy: np.ndarray
    layer_give: np.ndarray
    layer_drop: np.ndarray
    layer_spin: np.ndarray
    rest_tip: np.ndarray
    rest_volume: np.ndarray
    mass: float
    gravity_m_s2: np.ndarray
    pressure_min_pa: float
    pressure_max_pa: float
    load_low: np.ndarray
    load_high: np.ndarray
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    youngs_modulus_pa: float
    symmetry: str
    modes: np.ndarray
    singular_values: np.ndarray
    robot_name: str

    @property
    def chambers(self) -> int:
        """Number of pressure chambers."""
        return len(self.rest_volume)

    @property
    def layers(self) -> int:
        """Number of layers of the wall."""
        return len(self.layer_energy)

    @property
    def order(self) -> int:
        """Number of coordinates, chambers + 3."""
        return len(self.frame)

    def validate(self) -> None:
        """Check that shapes agree and that the rest is free of load."""
        super().validate()
        order = self.chambers + 3
        if self.frame.shape != (order, order):
            raise ArtifactError(f"ReducedModel.frame has shape {self.frame.shape}; expected {(order, order)}")
        for name, rows in (
            ("stiffness_root", order * (order + 1) // 2),
            ("stiffness_factor", order),
            ("stiffness_root_by_gravity", 3 * order * (order + 1) // 2),
            ("centre_of_mass", 3),
            ("rotation", 3),
            ("give", 9),
            ("give_rotation", 9),
            ("inner_give", TRIANGLE),
            ("inner_rotation", 3 * SHAPES),
            ("inner_root", SHAPES * order + TRIANGLE),
            ("drag_root", SHAPES * order + TRIANGLE),
            ("layer_give", self.layers * (self.layers + 1) // 2),
            ("layer_drop", 3 * self.layers),
            ("layer_spin", 3 * self.layers),
        ):
            if len(getattr(self, name)) != rows:
                raise ArtifactError(f"ReducedModel.{name} has {len(getattr(self, name))} rows; expected {rows}")
        if len(self.amplitudes) < order or self.amplitudes[:, 0].any():
            raise ArtifactError(
                f"ReducedModel.amplitudes has {len(self.amplitudes)} rows, the first of {self.amplitudes[0, 0]:g} at rest; "
                f"expected at least {order}, and zero at rest"
            )
        if np.triu(self.stiffness_factor, 1).any():
            raise ArtifactError("ReducedModel.stiffness_factor has entries above its diagonal; expected a lower triangle")
        if np.abs(self.energy[: 1 + order]).max() > 0.0:
            raise ArtifactError("ReducedModel.energy has terms of degree 0 or 1; the rest must be free of load")
        if self.modes.ndim != 3 or self.modes.shape[2] != 3:
            raise ArtifactError(f"ReducedModel.modes has shape {self.modes.shape}; expected (modes, nodes, 3)")
