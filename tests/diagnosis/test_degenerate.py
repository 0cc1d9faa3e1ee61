"""Recordings as laboratories have them at first: one step, one run, five or five hundred rows a second, a dead gauge.

A lag of 0.2 s filling and 0.3 s venting is hidden in all of them. It is named, or what stands in the way is said.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from softrl.core.config import build
from softrl.core.errors import RecordingError
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.lag import Lag
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.program import random_steps
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, node

pytestmark = pytest.mark.slow
ROBOT = build(node("robot/three_chamber_segment.yaml"), Robot, "robot")
BODY = PccSimulator(robot=ROBOT, **node("simulator/pcc.yaml"))
FULL = ROBOT.pressure_max_pa
Command = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


class Kind(NamedTuple):
    """How runs were recorded: how many and how long, their rows, commands (run, time, random steps), noise and gauge."""

    runs: int = 4
    duration_s: float = 20.0
    period_s: float = 0.02
    command: Command | None = None
    noise_m: float = 1e-4
    measured: bool = False
    process: Callable[[Recording], Recording] | None = None


def recorded(kind: Kind) -> RecordingSet:
    plant = Plant(BODY.with_parameters(bending_stiffness_scale=1.1), chain_of(ROBOT, (Lag(fill_s=0.2, vent_s=0.3),)))
    rng, runs = np.random.default_rng(0), []
    for number in range(kind.runs):
        time = kind.period_s * np.arange(1, round(kind.duration_s / kind.period_s) + 1)
        steps = random_steps(ROBOT, int(kind.duration_s / 2.0) + 2, 2.0, kind.period_s, rng)[1][: len(time)]
        command = kind.command(number, time, steps) if kind.command else steps
        seen = replay(plant, Recording(f"run_{number}", f"day_{number}", time, command), 0.005)
        assert seen.position is not None and seen.pressure_meas is not None
        gauge = seen.pressure_meas + 50.0 * rng.standard_normal(command.shape) if kind.measured else None
        position = seen.position + kind.noise_m * rng.standard_normal(seen.position.shape)
        one = replace(seen, position=position, pressure_meas=gauge)
        runs.append(kind.process(one) if kind.process else one)
    return RecordingSet(robot_name=ROBOT.name, recordings=tuple(runs))


def _one_chamber(number: int, time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    return steps * [0.0, 1.0, 0.0]


def _every_other_stands(number: int, time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    return np.full_like(steps, 0.2 * FULL) if number % 2 else steps


def _one_step(number: int, time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    return np.where(time[:, None] > 3.0 + number, [0.5 * FULL, 0.2 * FULL, 0.0], 0.0)


def _last_stands(number: int, time: np.ndarray, steps: np.ndarray) -> np.ndarray:
    return np.zeros_like(steps) if number == 2 else steps


def _quantised(run: Recording) -> Recording:
    assert run.position is not None
    return replace(run, position=np.round(run.position, 3))


def _unix_time(run: Recording) -> Recording:
    return replace(run, time=run.time + 1.7e9)


def _dead_gauge(run: Recording) -> Recording:
    return replace(run, pressure_meas=np.zeros_like(run.pressure_cmd))


def _frozen(run: Recording) -> Recording:
    assert run.position is not None
    position = run.position.copy()
    position[200:300] = position[200]
    return replace(run, position=position)


NAMED = {
    "one chamber": Kind(command=_one_chamber),
    "every other run stands": Kind(command=_every_other_stands),
    "every other run stands, gauge": Kind(command=_every_other_stands, measured=True),
    "one step a run": Kind(command=_one_step),
    "vacuum": Kind(command=lambda number, time, steps: steps - 0.1 * FULL),
    "no noise": Kind(noise_m=0.0),
    "5 Hz": Kind(duration_s=60.0, period_s=0.2),
    "500 Hz": Kind(duration_s=8.0, period_s=0.002),
    "dead gauge": Kind(process=_dead_gauge),
    "runs of 5 s": Kind(runs=8, duration_s=5.0),
    "the last run stands": Kind(runs=3, command=_last_stands),
    "to the millimetre": Kind(process=_quantised),
    "Unix times": Kind(process=_unix_time),
}
NOT_TOLD = {"one run": Kind(runs=1, duration_s=60.0), "tracking that freezes": Kind(process=_frozen)}


@pytest.mark.parametrize("kind", NAMED.values(), ids=NAMED.keys())
def test_a_lag_is_named(kind: Kind) -> None:
    found = run(configured(), ROBOT, recorded(kind), BODY, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["lag"], found.sentences
    assert found.verdict in ("named", "indistinguishable"), found.sentences


@pytest.mark.parametrize("kind", NOT_TOLD.values(), ids=NOT_TOLD.keys())
def test_what_stands_in_the_way_is_said(kind: Kind) -> None:
    try:
        found = run(configured(), ROBOT, recorded(kind), BODY, tracker=NullTracker())
    except RecordingError as refused:
        assert "\n" not in str(refused)
    else:
        assert found.verdict == "unknown", found.sentences
