"""How a reduced model is fitted to equilibria."""

from dataclasses import dataclass

from softrl.pod.energy import Weights
from softrl.pod.symmetry import images_of
from softrl.robots.robot import Robot


@dataclass(frozen=True)
class FitSettings:
    """How the maps are fitted.

    Attributes
    ----------
    energy_degree_max, map_degree_max, root_degree_max : highest degree tried for the energy, for centre of mass and
        rotation, and for the roots of mass and stiffness
    ridges : ridges tried for the energy, relative
    image_weights : weights tried for the samples' images under the robot's symmetries; a sample has 1
    anchor_weights : weights tried for the anchors, all of them together against all samples
    weights : of values, Hessians and third derivatives against gradients
    folds : parts of the cross-validation
    """

    energy_degree_max: int
    map_degree_max: int
    root_degree_max: int
    ridges: tuple[float, ...]
    image_weights: tuple[float, ...]
    anchor_weights: tuple[float, ...]
    weights: Weights
    folds: int

    def image_weights_of(self, robot: Robot) -> tuple[float, ...]:
        """Return the weights of images that make a difference: a robot without symmetry has no images."""
        return self.image_weights if images_of(robot) else (0.0,)
