"""The trial of layers: against itself a body errs by nothing, and what the layers do is told beside it."""

import numpy as np
import pytest

from softrl.bench.layers import layer_metrics
from softrl.core.errors import SolverError
from softrl.pod.simulator import RomSimulator
from tests.pod.conftest import fitted


class Falls(RomSimulator):
    """Finds no equilibrium where a layer is soft."""

    def equilibrium(self, pressure: np.ndarray, tip_force: np.ndarray | None = None):  # type: ignore[no-untyped-def]
        if self.layer_scales and min(self.layer_scales) < 0.9:
            raise SolverError("it fell over")
        return super().equilibrium(pressure, tip_force)


def test_a_body_is_itself_and_its_layers_matter() -> None:
    robot, _, model = fitted(3)
    body = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    metrics = layer_metrics(body, body, 6, np.random.default_rng(0))  # type: ignore[arg-type]
    assert metrics["rom_layer_tip_rms_mm"] == pytest.approx(0.0, abs=1e-9) and metrics["rom_layer_lost"] == 0
    assert metrics["baseline_no_layer_tip_rms_mm"] > 0.1
    assert metrics["rom_layer_orientation_rms_deg"] < 1e-5


def test_what_falls_over_is_counted() -> None:
    robot, _, model = fitted(3)
    sizes = (RomSimulator(robot, model, 1.0, 1.0, 1.0), Falls(robot, model, 1.0, 1.0, 1.0))
    metrics = layer_metrics(*sizes, 8, np.random.default_rng(0))  # type: ignore[arg-type]
    assert 0 < metrics["rom_layer_lost"] < 8 and metrics["rom_layer_tip_rms_mm"] < 1e-9
