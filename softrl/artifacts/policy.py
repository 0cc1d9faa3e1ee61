"""A trained controller as arrays: no library of its training is needed to run it."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError

ACTIVATIONS = ("relu", "tanh")
SQUASHES = ("tanh", "clip")
TOLD_AS = ("position", "joints")


@dataclass(frozen=True)
class Policy(Artifact):
    """Actor network from scaled observations to scaled joint commands, for one robot and task.

    An observation row is ``[tip (3), theta (3), contact force (1), then per target of the horizon: position (3),
    force (1)]``: positions as ``(x - position_centre) / position_scale``, theta as ``-1 .. 1`` over the joint limits,
    forces over ``force_scale``. A policy with a memory sees after these, per earlier reading, the latest first:
    ``[tip (3), theta (3)]``. One that is told joints sees positions as the actions that lead there on the surrogate's twin
    (centre 0, scale 1). An action in ``-1 .. 1`` spans the joint limits.

    Attributes
    ----------
    weights : ``weight_i`` (out, in) and ``bias_i`` (out,) of the layers in order
    activation : between layers, relu or tanh
    squash : after the last layer, tanh or clip to -1 .. 1
    horizon : number of targets in an observation, the one to reach next first
    position_centre : (3,) m;  position_scale : m;  force_scale : N
    joint_low, joint_high : (3,) rad, rad, m
    task_name, task : the task and its numbers
    agent_name : what trained it
    step_s : time between two actions
    metrics : what the stage measured
    robot_name : the robot
    told_as : how positions are told, position or joints
    memory : number of earlier readings in an observation
    average_window : commands in the moving average that it was trained behind
    effects : names of the effects of the simulator that it was trained on
    retuned : whether that simulator has the parameters that a diagnosis found
    """

    stage: ClassVar[str] = "rl"

    weights: dict[str, np.ndarray]
    activation: str
    squash: str
    horizon: int
    position_centre: np.ndarray
    position_scale: float
    force_scale: float
    joint_low: np.ndarray
    joint_high: np.ndarray
    task_name: str
    task: dict[str, Any]
    agent_name: str
    step_s: float
    metrics: dict[str, Any]
    robot_name: str
    told_as: str = "position"
    memory: int = 0
    average_window: int = 1
    effects: tuple[str, ...] = ()
    retuned: bool = False

    @property
    def layers(self) -> int:
        """Number of layers of the actor."""
        return sum(name.startswith("weight_") for name in self.weights)

    @property
    def corrected(self) -> bool:
        """Whether it was trained on another simulator than the nominal one: it sends the robot's own pressures, without f_RS."""
        return bool(self.effects) or self.retuned

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return observation_size(self.horizon, self.memory)

    def validate(self) -> None:
        """Check that the layers fit together, the observation and the action."""
        super().validate()
        if self.activation not in ACTIVATIONS or self.squash not in SQUASHES:
            raise ArtifactError(
                f"Policy has activation={self.activation}, squash={self.squash}; expected one of {ACTIVATIONS} and {SQUASHES}"
            )
        if self.told_as not in TOLD_AS:
            raise ArtifactError(f"Policy has told_as={self.told_as}; expected one of {TOLD_AS}")
        size = self.observation_size
        for i in range(self.layers):
            rows, columns = self.weights[f"weight_{i}"].shape
            if columns != size or self.weights[f"bias_{i}"].shape != (rows,):
                raise ArtifactError(
                    f"Policy.weight_{i} has shape {(rows, columns)}; expected {size} columns"
                    + (f" (horizon {self.horizon}, memory {self.memory})" if i == 0 else "") + "; rerun stage=rl"
                )
            size = rows
        if size != 3:
            raise ArtifactError(f"Policy ends in {size} outputs; expected 3, the grouped joint command")


def observation_size(horizon: int, memory: int = 0) -> int:
    """Return the length of an observation that shows ``horizon`` targets and ``memory`` earlier readings."""
    return 7 + 4 * horizon + 6 * memory
