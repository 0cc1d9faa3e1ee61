"""Rows slower than the motion make noise of it, until a model shows that the noise is less."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.cost import expected_s
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.checks.floor import jitter
from softrl.diagnosis.checks.within import within
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.quieter import quieter, supposed
from softrl.diagnosis.stage import diagnose, run
from softrl.diagnosis.telling.figures import draw_run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, node

NOISE_M, PRESSURE_PA, FILL_S, VENT_S = 1e-4, 500.0, 0.3, 0.5
TRUE_M = np.sqrt(3.0) * NOISE_M
Program = Callable[[np.ndarray, int, np.random.Generator], np.ndarray]


@pytest.fixture(scope="module")
def segment() -> PccSimulator:
    robot = build(node("robot/three_chamber_segment.yaml"), Robot, "robot")
    return PccSimulator(robot=robot, **node("simulator/pcc.yaml"))


def sines(time: np.ndarray, chambers: int, rng: np.random.Generator) -> np.ndarray:
    """Return commands (steps, chambers) from 0 to 1, the quickest part of 5 s."""
    phase = rng.uniform(0.0, 2.0 * np.pi, (chambers, 1, 6))
    waves = np.sin(2.0 * np.pi * np.geomspace(0.02, 0.2, 6) * time[:, None] + phase).sum(axis=2).T
    return np.asarray(0.5 * (1.0 + waves / np.abs(waves).max()))


def held(rows: int) -> Program:
    """Return a program of random commands, each held for so many rows."""
    return lambda time, chambers, rng: np.repeat(rng.uniform(size=(-(-len(time) // rows), chambers)), rows, axis=0)[: len(time)]


def lagging(
    segment: PccSimulator, period_s: float, program: Program, hidden: Effect | None = None, lasts_s: float = 120.0
) -> RecordingSet:
    """Return four sessions, of two minutes if not told, behind a lag, or what is ``hidden``."""
    rng, robot = np.random.default_rng(3), segment.robot
    plant, runs = Plant(segment, chain_of(robot, [hidden or Lag(FILL_S, VENT_S)])), []
    time = period_s * np.arange(1, round(lasts_s / period_s) + 1)
    for k in range(4):
        command = robot.pressure_max_pa * program(time, robot.chambers, rng)
        seen = replay(plant, Recording(f"run_{k}", f"day_{k}", time, command, position=np.zeros((len(time), 3))), 0.005)
        noisy = np.asarray(seen.position) + NOISE_M * rng.standard_normal((len(time), 3))
        gauges = np.asarray(seen.pressure_meas) + PRESSURE_PA * rng.standard_normal(command.shape)
        runs.append(replace(seen, position=noisy, quaternion=None, pressure_meas=gauges))
    return RecordingSet(robot.name, tuple(runs), {})


@pytest.fixture(scope="module")
def slow(segment: PccSimulator) -> RecordingSet:
    """One row a second."""
    return lagging(segment, 1.0, sines)


def test_motion_of_another_pose_in_every_row_is_no_noise(segment: PccSimulator) -> None:
    data = prepare(lagging(segment, 1.0, held(1)), segment.robot, 0.3, 0)
    assert isinstance(data, Data)
    told = np.sqrt(3.0) * jitter(np.asarray(data.training[0].position))
    assert told > 0.5 * data.travel > 5.0 * data.noise > TRUE_M
    assert 0.9 * PRESSURE_PA < data.pressure_noise / np.sqrt(3.0) < 2.0 * PRESSURE_PA


def test_a_lag_is_seen_by_gauges_that_show_every_pose_once(segment: PccSimulator) -> None:
    config = configured(candidates=["lag", "dead_time"])
    recordings = replace(lagging(segment, 1.0, held(1)), notes={"command_acts": "until_row"})
    found, evidence = diagnose(config, segment.robot, recordings, segment)
    assert found.verdict == "named", found.sentences
    (effect,) = found.effects
    assert effect["name"] == "lag" and effect["evidence"].startswith("command to measured pressure"), effect
    assert abs(effect["parameters"]["fill_s"]["value"] / FILL_S - 1.0) < 0.03
    assert abs(effect["parameters"]["vent_s"]["value"] / VENT_S - 1.0) < 0.03
    assert evidence is not None and len(evidence.heldout.runs) == 1
    drawn = [line.get_label() for line in draw_run(evidence.heldout, evidence.traces).axes[1].lines]
    assert f"corrected: rms {found.errors_mm['heldout']['corrected']:.3g} mm" in drawn  # rows that do not count are not drawn


@pytest.mark.slow
def test_hysteresis_is_named_though_it_makes_noise_of_every_pose(segment: PccSimulator) -> None:
    config = configured(candidates=["lag", "hysteresis", "payload", "gain"], measured_pressure=False)
    recordings = lagging(segment, 5.0, held(1), Hysteresis(0.15, 0.02))
    data = prepare(recordings, segment.robot, config.heldout_share, config.seed)
    assert isinstance(data, Data) and data.at_most
    found = run(config, segment.robot, recordings, segment, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["hysteresis"], found.sentences
    assert abs(found.effects[0]["parameters"]["height"]["value"] / 0.15 - 1.0) < 0.1
    assert found.errors_mm["heldout"]["corrected"] < 0.5e3 * data.noise


def test_gauges_of_a_single_run_are_not_asked_what_commands_foretell(segment: PccSimulator) -> None:
    first, *others = lagging(segment, 1.0, held(1)).recordings
    recordings = RecordingSet(segment.robot.name, (first, *(replace(run, pressure_meas=None) for run in others)), {})
    data = prepare(recordings, segment.robot, 0.3, 0)
    assert isinstance(data, Data) and not data.pressure


def test_less_noise_is_supposed_but_no_less_than_rounding(segment: PccSimulator, slow: RecordingSet) -> None:
    data = prepare(slow, segment.robot, 0.3, 0)
    assert isinstance(data, Data)
    assert supposed(data).noise == pytest.approx(0.25 * data.noise)
    assert supposed(replace(data, rounding=0.5 * data.noise)).noise == pytest.approx(0.5 * data.noise)


def test_second_halves_of_holds_tell_the_noise_of_slow_rows(segment: PccSimulator) -> None:
    data = prepare(lagging(segment, 0.5, held(12)), segment.robot, 0.3, 0)
    assert isinstance(data, Data)
    assert {run.noise_from for run in data.check.runs} == {"holds"}
    assert data.noise == pytest.approx(TRUE_M, rel=0.25)


def test_a_lag_is_named_though_rows_are_slow(segment: PccSimulator, slow: RecordingSet) -> None:
    config = configured(candidates=["lag", "dead_time", "payload"], measured_pressure=False)
    found = run(config, segment.robot, slow, segment, tracker=NullTracker())
    assert found.verdict == "named", found.sentences
    (effect,) = found.effects
    assert effect["name"] == "lag"
    for name, value in (("fill_s", FILL_S), ("vent_s", VENT_S)):
        assert effect["parameters"][name]["low"] <= value <= effect["parameters"][name]["high"]
    assert 0.9e3 * TRUE_M < found.errors_mm["heldout"]["noise_floor"] < 1.5e3 * TRUE_M
    assert sum("noise was told as" in line for line in found.data["warnings"]) >= 1


def test_noise_is_believed_where_no_model_errs_by_less(segment: PccSimulator, slow: RecordingSet) -> None:
    data = prepare(slow, segment.robot, 0.3, 0)
    assert isinstance(data, Data)
    told = 1e3 * data.noise

    def after(**errors: float) -> Data | None:
        return quieter(data, _diagnosis({"noise_floor": told, **errors}))

    assert after(retuned=told, corrected=0.9 * told) is None
    heard = after(retuned=2.0 * told, corrected=0.5 * told)
    assert heard is not None and heard.noise == pytest.approx(0.5 * data.noise)
    assert quieter(replace(data, rounding=data.noise), _diagnosis({"noise_floor": told, "retuned": 0.5 * told})) is None
    assert quieter(data, _diagnosis({})) is None
    assert f"told as {told:.3g} mm, more than the {0.5 * told:.3g} mm by which the correction errs" in heard.mended[-1]
    angles = replace(_diagnosis({"corrected": 0.5 * told}), errors_deg={"heldout": {"corrected": 0.25 * told}})
    turned = quieter(data, angles)
    assert turned is not None and f"told as {0.5 * told:.3g} deg, more than the {0.25 * told:.3g} deg" in turned.mended[-1]


def _diagnosis(heldout: dict[str, float]) -> Diagnosis:
    return Diagnosis("robot", "PccSimulator", "nothing missing", [], [], {}, {}, [], [], {"heldout": heldout}, {}, {}, None, {})


@pytest.mark.parametrize("period_s", [0.1, 5.0, 30.0, 60.0])
def test_fits_see_as_many_of_the_slowest_rows_as_of_slow_ones(period_s: float) -> None:
    time = period_s * np.arange(1, max(round(300.0 / period_s), 100) + 1)
    runs = [Recording(f"run_{k}", f"day_{k}", time, np.zeros((len(time), 3))) for k in range(4)]
    seen = sum(len(run.time) for run in within(runs, 300.0))
    assert seen == pytest.approx(300.0 / min(period_s, 5.0), abs=8)


def test_a_search_of_rows_half_a_minute_apart_can_be_timed(segment: PccSimulator) -> None:
    runs, numerics = within(lagging(segment, 30.0, held(1), lasts_s=600.0).recordings, 50.0), configured().numerics
    body = Problem(segment.robot, segment, runs, numerics, "motion", "command", False, False)
    assert all(len(run.time) > 2 for run in runs) and 0.0 < expected_s(body, 1) < 1e5


@pytest.mark.slow
def test_poses_half_a_minute_apart_are_predicted_after_retuning(segment: PccSimulator) -> None:
    table = replace(lagging(segment, 30.0, held(1), Payload(mass=0.3), lasts_s=750.0), notes={"command_acts": "until_row"})
    config = configured(candidates=["lag", "payload"], measured_pressure=False)
    found = run(config, segment.robot, table, segment, tracker=NullTracker())
    assert found.verdict == "nothing missing", found.sentences  # at rest a retuned body stands as one with a payload
    assert found.errors_mm["heldout"]["corrected"] < 1.3e3 * TRUE_M and found.errors_mm["heldout"]["nominal"] > 3e3 * TRUE_M
