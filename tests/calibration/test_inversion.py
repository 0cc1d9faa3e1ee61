"""The reduced body's inverse is exact for the simulator that is asked, retuned or not."""

from typing import Any

import numpy as np
import pytest

from softrl.calibration.inversion import has_exact_inverse, pressure_by_reduced_model
from softrl.pod.simulator import RomSimulator
from tests.pod.conftest import fitted


@pytest.mark.parametrize("scales", [(1.0, 1.0, 1.0), (1.15, 0.8, 0.9), (1.0, 1.0, 1.0, (1.2, 1.0, 0.8))])
def test_the_reduced_body_is_inverted_with_its_scales(scales: tuple[Any, ...]) -> None:
    robot, _, model = fitted(3)
    simulator = RomSimulator(robot, model, *scales)
    assert has_exact_inverse(simulator, robot)
    pressure = np.random.default_rng(0).uniform(0.0, 0.3 * robot.pressure_max_pa, (5, 3))
    tip = np.stack([simulator.observe(simulator.equilibrium(row))[0] for row in pressure])
    found, miss = pressure_by_reduced_model(simulator, robot, tip)
    assert miss.max() < 1e-6
    np.testing.assert_allclose(found, pressure, atol=1e-3 * robot.pressure_max_pa)
