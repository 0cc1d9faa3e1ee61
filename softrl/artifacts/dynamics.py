"""The learned dynamics f_S and its inverse: weights with the scalers that belong to them."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class ForwardDynamics(Artifact):
    """f_S of eqs. 5-11: a window of states, rates and loads in, the rate of the state one step later out.

    The state X has 8 + n numbers: tip position p (3) m, arc length l (m) and curvature kappa (1/m) of the
    constant-curvature arc to it, rotation vector q (3) rad of the tip, which goes on beyond half a turn, and the change of the
    n chamber volumes (m^3). Row k of a window is (X_k, (X_k - X_k-1) / dt, the load that is held until k + 1); a load is (p_1 ..
    p_n Pa, F_x, F_y, F_z N).

    Attributes
    ----------
    weights : the state_dict of ``dynamics.transformer.ForwardNet``, scalers among them
    window : rows that the Transformer sees
    width, heads, layers, feedforward : its size
    linear_rows : rows that the closed form reads
    polynomial_degree : of the closed form in the coordinates
    dt_s : s, time step of the rows
    physics_weight : lambda of eq. 10 in training
    load_low, load_high : (n + 3,) Pa and N, range of the training loads
    rest_tip : (3,) m
    gravity_m_s2 : (3,) under which f_S was trained
    axis : direction of the backbone at rest
    chambers : n
    robot_name : the robot
    training_samples : rates that it was trained on; the reduced model made them
    full_order_share : of all samples made, those by the full model: they test, and none of them trains
    """

    stage: ClassVar[str] = "dynamics"

    weights: dict[str, np.ndarray]
    window: int
    width: int
    heads: int
    layers: int
    feedforward: int
    linear_rows: int
    dt_s: float
    physics_weight: float
    load_low: np.ndarray
    load_high: np.ndarray
    rest_tip: np.ndarray
    gravity_m_s2: np.ndarray
    axis: str
    chambers: int
    robot_name: str
    polynomial_degree: int = 1
    training_samples: int = 0
    full_order_share: float = 0.0

    def validate(self) -> None:
        """Check that the weights fit the window and the number of chambers."""
        super().validate()
        rows = 2 * (8 + self.chambers) + self.chambers + 3
        if self.weights["row_mean"].shape != (rows,):
            raise ArtifactError(
                f"ForwardDynamics expects {rows} numbers a row, its scaler has {self.weights['row_mean'].shape}"
            )


@dataclass(frozen=True)
class InverseDynamics(Artifact):
    """f_S^dagger of eqs. 15-18: two rows without the last pressures and the wanted next rate in, pressures (Pa) out.

    Attributes
    ----------
    weights : the state_dict of ``dynamics.inverse.InverseNet``, scalers among them
    hidden : width of its two hidden layers
    dt_s : s, time step
    cycle_weight : beta of eq. 18 in training
    chambers : n
    robot_name : the robot
    polynomial_degree : of its closed form in the coordinates
    """

    stage: ClassVar[str] = "dynamics"

    weights: dict[str, np.ndarray]
    hidden: int
    dt_s: float
    cycle_weight: float
    chambers: int
    robot_name: str
    polynomial_degree: int = 1
