"""The reduced model as the body that f_S is learned from."""

import numpy as np
import torch

from softrl.artifacts.reduced_model import ReducedModel
from softrl.pod.rom import roll, static_coordinates, tip_poses
from softrl.pod.twin.rom import TorchRom


class ReducedBody:
    """A ``ReducedModel`` behind ``dataset.Body``, under ``gravity_m_s2`` (3,) in the base frame."""

    def __init__(self, model: ReducedModel, gravity_m_s2: np.ndarray) -> None:
        self._model, self._gravity, self._twin = model, gravity_m_s2, TorchRom(model, gravity_m_s2)
        self.chambers, self.rest_tip = model.chambers, model.rest_tip
        self.rest = static_coordinates(model, np.zeros((1, model.order)), gravity_m_s2)[0]

    def roll(self, load: np.ndarray, start: np.ndarray, velocity: np.ndarray, dt_s: float) -> np.ndarray:
        """Return z (B, steps, n + 3) under ``load`` (B, steps, n + 3) from ``start`` and ``velocity`` (B, n + 3)."""
        return roll(self._model, dt_s, load, start, velocity, self._gravity)

    def residual(self, path: torch.Tensor, load: torch.Tensor, dt_s: float) -> torch.Tensor:
        """Return what the last step of ``path`` (B, K, n + 3) leaves in the balance of forces (B, n + 3), Pa and N."""
        return self._twin.residual(path, load, dt_s)

    def quaternion(self, z: np.ndarray) -> np.ndarray:
        """Return orientations (B, 4) w x y z of the tip at ``z`` (B, n + 3)."""
        return tip_poses(self._model, z, self._gravity)[1]
