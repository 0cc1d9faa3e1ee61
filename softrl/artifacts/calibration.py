"""The material behind the robot, and the map from commanded pressures to those of the simulator."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class Calibration(Artifact):
    """f_RS of eq. 1, ``P_S = P_R + net(P_R)``: an ensemble of small networks whose mean is the map.

    Inputs are scaled by ``pressure_mean`` and ``pressure_spread``, outputs by ``correction_spread``.

    Attributes
    ----------
    weights : name -> array, dimensionless, the members' along its first axis: ``skip`` (members, n, n) and ``bias`` (members, n)
        of the linear path, ``weight_k`` and ``bias_k`` of two tanh layers, ``weight_2`` (members, hidden, n) behind them
    members : number of networks
    pressure_mean, pressure_spread : (n,) Pa, scaler of P_R, fitted on training holds only
    correction_spread : (n,) Pa, size of P_S - P_R on training holds
    pressure_low, pressure_high : (n,) Pa, range of P_R that was seen in training
    pressure_real, pressure_sim : (holds, n) Pa, the pairs
    heldout : (holds,) bool, pairs that took no part in training
    inverted_by : "reduced model" or "simulator", what gave P_S
    material : law -> fitted parameters in Pa with errors; empty without a tensile curve
    robot_name : the robot
    settled_tip : (settled, 3) m, the tips of all settled holds, those that the simulator does not reach among them
    effects : names of those in the simulator whose pressures P_S are; f_RS then maps what they leave
    """

    stage: ClassVar[str] = "calibration"

    weights: dict[str, np.ndarray]
    members: int
    pressure_mean: np.ndarray
    pressure_spread: np.ndarray
    correction_spread: np.ndarray
    pressure_low: np.ndarray
    pressure_high: np.ndarray
    pressure_real: np.ndarray
    pressure_sim: np.ndarray
    heldout: np.ndarray
    inverted_by: str
    material: dict[str, Any]
    robot_name: str
    settled_tip: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    effects: tuple[str, ...] = ()

    @property
    def chambers(self) -> int:
        """Number of pressure chambers."""
        return len(self.pressure_mean)

    def validate(self) -> None:
        """Check that pairs agree in shape and that there is at least one network."""
        super().validate()
        if self.pressure_real.shape != self.pressure_sim.shape or len(self.heldout) != len(self.pressure_real):
            raise ArtifactError(
                f"Calibration pairs disagree: P_R {self.pressure_real.shape}, P_S {self.pressure_sim.shape}, "
                f"held-out flags {self.heldout.shape}"
            )
        if self.members < 1:
            raise ArtifactError("Calibration holds no network; run stage=calibration")
