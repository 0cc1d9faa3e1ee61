"""What Maxwell branches keep until a step's end is the same whether it was worked out beforehand or is when it is asked for."""

import numpy as np
import pytest

from softrl.effects.effect import STAGE, Effect
from softrl.effects.port import ADDED, ELASTIC, ELASTIC_SLOPE, REST, STRAIN, body_port
from softrl.effects.power_creep import PowerCreep
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.robots.robot import Robot
from tests.effects.test_library import simulator

DT_S = 0.01
WALLS = [Viscoelasticity(0.4, 2.0, 0.2, 20.0), PowerCreep(0.3, 0.3), PowerCreep(0.3, 0.3, chamber=1)]


def port_of(elastic: np.ndarray) -> np.ndarray:
    port = body_port(len(elastic))
    port[ELASTIC], port[ELASTIC_SLOPE] = elastic, 1e5
    port[STRAIN], port[REST] = elastic / 1e5, 1e5
    return port


def stepped(effect: Effect, robot: Robot, rng: np.random.Generator) -> np.ndarray:
    """Return the effect's state after some steps."""
    state = effect.reset(robot)
    for _ in range(5):
        port = port_of(rng.normal(0.0, 1e4, robot.chambers))
        type(effect).kernel(effect.pack(robot), state, port, DT_S, True)
    return state


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("after_s", [STAGE * DT_S, DT_S])
def test_what_is_known_beforehand_is_what_would_be_found(wall: Effect, after_s: float) -> None:
    robot, rng = simulator().robot, np.random.default_rng(3)
    state = stepped(wall, robot, rng)
    elastic = rng.normal(0.0, 1e4, robot.chambers)
    known, found = port_of(elastic), port_of(elastic)
    type(wall).kernel(wall.pack(robot), state, known, after_s, False)
    type(wall).kernel(wall.pack(robot), state, found, np.nextafter(after_s, 1.0), False)  # a time that is not known
    np.testing.assert_allclose(known, found, rtol=1e-9)
    assert np.abs(known[ADDED]).max() > 100.0


def test_a_step_of_another_length_is_taken_as_it_is() -> None:
    """Two steps of half the length end where one does, for a resistance that stays."""
    wall, robot = WALLS[0], simulator().robot
    whole = stepped(wall, robot, np.random.default_rng(3))
    halves, elastic = whole.copy(), np.full(robot.chambers, 5e3)
    for state in (whole, halves):
        type(wall).kernel(wall.pack(robot), state, port_of(elastic), DT_S, True)
    type(wall).kernel(wall.pack(robot), whole, port_of(elastic), 0.4, True)
    for _ in range(2):
        type(wall).kernel(wall.pack(robot), halves, port_of(elastic), 0.2, True)
    np.testing.assert_allclose(halves[: 2 * robot.chambers], whole[: 2 * robot.chambers], rtol=1e-12)
