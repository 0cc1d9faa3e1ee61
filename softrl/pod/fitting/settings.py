"""How a reduced model is fitted to equilibria."""

from dataclasses import dataclass

from softrl.core.errors import ConfigError
from softrl.pod.fitting.energy import Weights
from softrl.robots.robot import Robot
from softrl.robots.symmetry import images_of


@dataclass(frozen=True)
class FitSettings:
    """How the maps are fitted.

    Attributes
    ----------
    energy_degree_max : highest degree tried for the condensed energy
    map_degree_max : likewise for the rotation
    amplitude_degree_max : for the amplitudes, whose gradient makes the mass;  amplitudes_max : at most so many besides the
        n + 3 of what they leave
    viscosity_degree_max : for the root of viscosity
    root_degree_max : for the roots of what the inside gives
    ridges : tried for the energy, relative
    image_weights : tried for the samples' images under the robot's symmetries, beside the samples' own weight of 1
    anchor_weights : tried for the equilibria of a lower degree to which a higher one is held beyond the samples, all of
        them together against all samples
    value_weight, hessian_weight, third_weight : of the energy's values, Hessians and third derivatives in its fit,
        gradients weigh 1
    folds : of the cross-validation that chooses degree, ridge and weight of images
    """

    energy_degree_max: int
    map_degree_max: int
    amplitude_degree_max: int
    amplitudes_max: int
    viscosity_degree_max: int
    root_degree_max: int
    ridges: tuple[float, ...]
    image_weights: tuple[float, ...]
    anchor_weights: tuple[float, ...]
    value_weight: float
    hessian_weight: float
    third_weight: float
    folds: int

    def __post_init__(self) -> None:
        for name, least in {
            "energy_degree_max": 2, "map_degree_max": 1, "amplitude_degree_max": 1, "amplitudes_max": 1,
            "viscosity_degree_max": 0, "root_degree_max": 0, "value_weight": 0, "hessian_weight": 0, "third_weight": 0,
            "folds": 2,
        }.items():  # fmt: skip
            if getattr(self, name) < least:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be at least {least}")
        if not self.ridges or min(self.ridges) <= 0.0:
            raise ConfigError(f"stage.ridges={self.ridges}; expected one or more positive numbers")
        if not self.image_weights or not all(0.0 <= weight <= 1.0 for weight in self.image_weights):
            raise ConfigError(f"stage.image_weights={self.image_weights}; expected numbers from 0 to 1")
        if not all(0.0 <= weight <= 1.0 for weight in self.anchor_weights):
            raise ConfigError(f"stage.anchor_weights={self.anchor_weights}; expected numbers from 0 to 1")

    @property
    def weights(self) -> Weights:
        """Weights of the energy's equations."""
        return Weights(self.value_weight, self.hessian_weight, self.third_weight)

    def image_weights_of(self, robot: Robot) -> tuple[float, ...]:
        """Return the weights of images that make a difference: a robot without symmetry has no images."""
        return self.image_weights if images_of(robot) else (0.0,)
