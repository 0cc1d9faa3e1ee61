"""The trial at rest: against itself a body errs by nothing, against one shifted by the shift, and tip forces count."""

import numpy as np
import pytest

from softrl.bench.resting import resting_metrics
from softrl.core.errors import SolverError
from softrl.pod.simulator import RomSimulator
from tests.pod.conftest import fitted


class Shifted(RomSimulator):
    """Stands a millimetre beside where it should, and finds no equilibrium where the tip is pushed upwards."""

    def equilibrium(self, pressure: np.ndarray, tip_force: np.ndarray | None = None):  # type: ignore[no-untyped-def]
        assert tip_force is not None
        if tip_force[2] > 0.0:
            raise SolverError("it fell over")
        return super().equilibrium(pressure, tip_force)

    def observe(self, state):  # type: ignore[no-untyped-def]
        tip, turn = super().observe(state)
        return tip + np.array([0.0, 1e-3, 0.0]), turn


def test_a_body_is_itself_and_another_is_not() -> None:
    robot, _, model = fitted(3)
    body, shifted = (kind(robot, model, 1.0, 1.0, 1.0) for kind in (RomSimulator, Shifted))
    same = resting_metrics(body, body, 8, np.random.default_rng(0))  # type: ignore[arg-type]
    assert same["rom_static_tip_rms_mm"] == 0.0 and same["rom_static_lost"] == 0
    assert same["baseline_rest_static_tip_rms_mm"] > 1.0
    other = resting_metrics(body, shifted, 8, np.random.default_rng(0))  # type: ignore[arg-type]
    assert other["rom_static_tip_rms_mm"] == pytest.approx(1.0) and other["rom_static_tip_max_mm"] == pytest.approx(1.0)
    assert 0 < other["rom_static_lost"] < 8 and other["rom_static_orientation_rms_deg"] < 1e-5


def test_a_tip_force_moves_the_rest_as_a_long_step_does() -> None:
    robot, _, model = fitted(3)
    body = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    pressure, force = np.full(3, 0.3 * robot.pressure_max_pa), np.array([0.5, 0.0, -0.2]) * robot.tip_force_max_n
    state = body.reset()
    for _ in range(1000):
        state = body.step(state, pressure, 0.02, force)
    tip = body.observe(body.equilibrium(pressure, force))[0]
    assert np.linalg.norm(tip - body.observe(body.equilibrium(pressure))[0]) > 1e-4
    assert tip == pytest.approx(body.observe(state)[0], abs=1e-7)
