"""A program that sends commands by its own clock, beside a logger that finds them up to a row late, hides and invents nothing."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured

PERIOD_S, HOLD, MOVES, NOISE_M = 0.04, 30, 14, 1e-4
RIVALS = ["delay", "dead_time", "lag", "rate_limit", "deadband", "hysteresis"]


def recorded(body: PccSimulator, effects: tuple[Effect, ...], rows_late: float, seed: int = 0) -> RecordingSet:
    """Return runs of held pressures, each sent up to ``rows_late`` rows before the row that shows it; in the last none moves."""
    rng, runs = np.random.default_rng(seed), []
    plant = Plant(body, chain_of(body.robot, effects))
    time = PERIOD_S * np.arange(1, HOLD * MOVES + 1)
    for number in range(6):
        levels = body.robot.pressure_max_pa * rng.uniform(0.0, 0.8, (MOVES, body.robot.chambers))
        levels[:] = levels[0] if number == 5 else levels
        blank = Recording(f"run_{number}", f"day_{number}", time, levels.repeat(HOLD, axis=0))
        later = PERIOD_S * (1.0 - rng.uniform(0.0, rows_late, MOVES)).repeat(HOLD)
        ends = np.r_[later[1:], 0.0]  # a row acts until its time, and until the next one's command is sent
        seen = replay(plant, blank, 0.005, later=ends)
        assert seen.position is not None
        noisy = seen.position + NOISE_M * rng.standard_normal(seen.position.shape)
        runs.append(replace(blank, position=noisy))
    return RecordingSet(robot_name=body.robot.name, recordings=tuple(runs))


def diagnosed(body: PccSimulator, recordings: RecordingSet) -> Diagnosis:
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


def test_commands_sent_by_another_clock_are_no_physics(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, (), 1.0))
    assert found.verdict == "nothing missing", found.sentences
    assert any(line.startswith("Commands were sent by another clock") for line in found.sentences)
    held = found.errors_mm["heldout"]
    assert held["retuned"] < 1.2 * held["noise_floor"] < 0.5 * held["nominal"]


@pytest.mark.slow
def test_a_lag_behind_another_clock_is_named(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, (Lag(fill_s=0.3, vent_s=0.3),), 1.0))
    assert [effect["name"] for effect in found.effects] == ["lag"], found.sentences
    assert found.effects[0]["parameters"]["fill_s"]["value"] == pytest.approx(0.3, rel=0.05)


@pytest.mark.slow
def test_what_holds_moves_back_for_longer_than_a_row_is_no_clock(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, (), 5.0))
    assert found.verdict == "unknown", found.sentences
    assert not any("another clock" in line for line in found.sentences)
