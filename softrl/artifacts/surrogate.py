"""The rigid-link stand-in of a soft robot: links, joints, stiffness and the maps between pressures and joints."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class Surrogate(Artifact):
    """Planar links on a chain of gaps; every gap turns by theta_x, then theta_y, then slides by d along its own z.

    The command is grouped: all gaps share one ``theta = (theta_x rad, theta_y rad, d m)``, while each joint yields to
    loads by its own spring.

    Attributes
    ----------
    urdf : text of the URDF, metres and kilograms, z along the robot
    joint_height : (gaps,) m, height at rest of each gap's two hinges
    plane_height : (gaps,) m, height at rest of the planar link above each gap
    plane_radius : (gaps,) m, of that link
    neck_radius : m, smallest radius of the body
    tip_height : m, height of the tip at rest
    joint_low, joint_high : (3,) rad, rad, m: range of motion of the grouped command
    joint_stiffness : (3,) N m/rad, N m/rad, N/m of the joints of a mean gap at rest, the others being free
    contact_stiffness_n_per_m, contact_damping_n_s_per_m : of the tip against a surface
    mass : kg, of all links
    gravity_m_s2 : (3,) in the base frame, under which the body hung
    rayleigh_mass_per_s, rayleigh_stiffness_s : the body's damping, by its inertia and by its stiffness
    sample_pressure : (samples, n) Pa, sampled at equilibrium
    sample_tip : (samples, 3) m, the body's tip there
    sample_joints : (samples, 3) fitted grouped commands there
    heldout : (samples,) bool, rows that no training saw
    forward : f_SP, pressure -> joints: ``skip`` (n, 3), ``weight_i``, ``bias_i``
    inverse : joints -> pressure, likewise
    pressure_mean, pressure_spread : (n,) Pa, scaler of the pressures
    joint_mean, joint_spread : (3,) scaler of the joints
    pressure_low, pressure_high : (n,) Pa, range that was sampled
    metrics : the numbers that the stage measured
    robot_name : the robot
    softness_coefficients : (terms, 6), how a mean gap yields to loads by the commanded pose: see ``surrogate.springs``;
        none where every pose has ``joint_stiffness``
    gap_share : (gaps,), by which each gap is softer than the mean gap
    """

    schema: ClassVar[int] = 2
    stage: ClassVar[str] = "surrogate"

    urdf: str
    joint_height: np.ndarray
    plane_height: np.ndarray
    plane_radius: np.ndarray
    neck_radius: float
    tip_height: float
    joint_low: np.ndarray
    joint_high: np.ndarray
    joint_stiffness: np.ndarray
    contact_stiffness_n_per_m: float
    contact_damping_n_s_per_m: float
    mass: float
    gravity_m_s2: tuple[float, ...]
    rayleigh_mass_per_s: float
    rayleigh_stiffness_s: float
    sample_pressure: np.ndarray
    sample_tip: np.ndarray
    sample_joints: np.ndarray
    heldout: np.ndarray
    forward: dict[str, np.ndarray]
    inverse: dict[str, np.ndarray]
    pressure_mean: np.ndarray
    pressure_spread: np.ndarray
    joint_mean: np.ndarray
    joint_spread: np.ndarray
    pressure_low: np.ndarray
    pressure_high: np.ndarray
    metrics: dict[str, Any]
    robot_name: str
    softness_coefficients: np.ndarray = field(default_factory=lambda: np.empty((0, 6)))
    gap_share: np.ndarray = field(default_factory=lambda: np.empty(0))

    @property
    def gaps(self) -> int:
        """Number of gaps, which is the number of planar links that move."""
        return len(self.plane_height)

    @property
    def chambers(self) -> int:
        """Number of pressure chambers."""
        return self.sample_pressure.shape[1]

    def require_robot(self, name: str, gravity_m_s2: tuple[float, ...]) -> None:
        """Raise ``ArtifactError`` unless the robot is ``name`` and hangs in ``gravity_m_s2`` (3,), which the commands contain."""
        if self.robot_name != name:
            raise ArtifactError(f"the surrogate is of robot {self.robot_name}, but robot={name}; rerun stage=surrogate")
        if not np.allclose(self.gravity_m_s2, gravity_m_s2, atol=1e-6):
            raise ArtifactError(
                f"the surrogate of {name} hangs in gravity {list(self.gravity_m_s2)} m/s^2, but "
                f"robot.gravity_m_s2={list(gravity_m_s2)}; rerun stage=surrogate"
            )

    def validate(self) -> None:
        """Check that heights rise, limits are ordered and springs are positive."""
        super().validate()
        heights = np.column_stack([self.joint_height, self.plane_height]).ravel()
        if (np.diff([0.0, *heights, self.tip_height]) < 0).any():
            raise ArtifactError(
                f"surrogate of {self.robot_name}: joint and plane heights {heights} m do not rise to the tip"
            )
        if (self.joint_low >= self.joint_high).any():
            raise ArtifactError(
                f"surrogate of {self.robot_name}: joint limits {self.joint_low} .. {self.joint_high} are empty"
            )
        if (self.joint_low > 0).any() or (self.joint_high < 0).any():
            raise ArtifactError(
                f"surrogate of {self.robot_name}: joint limits {self.joint_low} .. {self.joint_high} (rad, rad, m) exclude the "
                "rest pose, where all joints are zero; run stage=surrogate anew"
            )
        if (self.joint_stiffness <= 0).any():
            raise ArtifactError(
                f"surrogate of {self.robot_name}: joint stiffness {self.joint_stiffness} is not positive"
            )
        if min(self.rayleigh_mass_per_s, self.rayleigh_stiffness_s) < 0:
            raise ArtifactError(
                f"surrogate of {self.robot_name}: damping {self.rayleigh_mass_per_s:g} 1/s, {self.rayleigh_stiffness_s:g} s; "
                "expected none that is negative"
            )
        if self.softness_coefficients.size and len(self.gap_share) != self.gaps:
            raise ArtifactError(
                f"surrogate of {self.robot_name}: gap_share has {len(self.gap_share)} values for {self.gaps} gaps"
            )
        for name in ("sample_tip", "sample_joints", "heldout"):
            if len(getattr(self, name)) != len(self.sample_pressure):
                raise ArtifactError(
                    f"Surrogate.{name} has {len(getattr(self, name))} rows for {len(self.sample_pressure)} pressures"
                )
