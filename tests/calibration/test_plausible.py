"""A mistake in the recordings is told as such, and not fitted as pressure."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.calibration.plausible import look_over
from softrl.calibration.stage import run
from softrl.core.driver import Driver
from softrl.core.errors import RecordingError
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.program import random_steps
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.calibration.test_stage import STEPPING, config

Moved = Callable[[np.ndarray, int], np.ndarray]
TURN = Rotation.from_euler("z", 20.0, degrees=True).as_matrix()


def recorded(robot: Robot, body: PccSimulator, acting: Callable[[np.ndarray], np.ndarray], moved: Moved) -> RecordingSet:
    """Return four runs behind a valve with a lag, tips of run k as ``moved(tip, k)``."""
    rng, found = np.random.default_rng(2), []
    for k in range(4):
        time, pressure = random_steps(robot, 8, 2.0, 0.02, rng)
        tip = Plant(body, chain_of(robot, [Lag(0.1, 0.2)])).simulate(time, acting(pressure)).position
        found.append(Recording(f"r{k}", f"s{k}", time, pressure, position=moved(tip, k)))
    return RecordingSet(robot.name, tuple(found))


@pytest.mark.parametrize("moved", [lambda p, k: p * [1, -1, 1], lambda p, k: p[:, [1, 0, 2]]])
def test_mirrored_and_exchanged_columns_are_refused(
    robot: Robot, body: PccSimulator, driver: Driver, acting: Callable[[np.ndarray], np.ndarray], moved: Moved
) -> None:
    recordings = recorded(robot, body, acting, moved)
    with pytest.raises(RecordingError, match=r"cannot be what they are called: .*mirror image"):
        run(config(), robot, body, chain_of(robot, ()), driver, recordings, tracker=NullTracker())


def test_exchanged_chambers_are_refused(
    robot: Robot, body: PccSimulator, acting: Callable[[np.ndarray], np.ndarray]
) -> None:
    true = recorded(robot, body, acting, lambda p, k: p)
    wrong = tuple(replace(r, pressure_cmd=r.pressure_cmd[:, [1, 0, 2]]) for r in true.recordings)
    with pytest.raises(RecordingError, match="mirror image"):
        look_over(replace(true, recordings=wrong), Plant(body, chain_of(robot, ())), STEPPING, 5e-4)


@pytest.mark.parametrize(
    "moved",
    [lambda p, k: p @ TURN.T, lambda p, k: p @ TURN.T if k < 2 else p, lambda p, k: p + np.array([0.02, 0.0, 0.0])],
)
def test_frames_that_differ_are_warned_of(
    robot: Robot, body: PccSimulator, acting: Callable[[np.ndarray], np.ndarray], moved: Moved,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    plant = Plant(body, chain_of(robot, ()))
    look_over(recorded(robot, body, acting, lambda p, k: p), plant, STEPPING, 5e-4)
    assert "a frame turned" not in caplog.text, "what pressures do is not taken for a frame"
    look_over(recorded(robot, body, acting, moved), plant, STEPPING, 5e-4)
    assert "session s0: a frame turned by" in caplog.text
