"""Whether a row's command acts before or after its time is tuned with every hypothesis: it is no physics."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis, late
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.hypothesis import LATE, Choice, Gate, Hypothesis, Space
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.dead_time import DeadTime
from softrl.effects.delay import Delay
from softrl.effects.effect import Effect
from softrl.effects.friction import Friction
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.proof.judging import built
from softrl.recordings.acting import ACTS, UNTIL
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made

INTERVAL_S = 0.02
VALVE, LOAD = Lag(fill_s=0.15, vent_s=0.15), Payload(mass=0.3)
RIVALS = ["delay", "dead_time", "lag", "tube_line", "payload"]


def ahead(run: Recording) -> Recording:
    """Return the run as a logger writes it whose commands act from their row on: all are an interval early."""
    return replace(run, pressure_cmd=np.vstack([run.pressure_cmd[1:], run.pressure_cmd[-1:]]))


def seen_late(run: Recording) -> Recording:
    """Return the run as a logger writes it whose camera is an interval behind."""
    assert run.position is not None and run.quaternion is not None
    late = [np.concatenate([track[:1], track[:-1]]) for track in (run.position, run.quaternion)]
    return replace(run, position=late[0], quaternion=late[1], bend_angle=None)


def diagnosed(body: PccSimulator, hidden: tuple[Effect, ...], measured: bool, early: bool) -> Diagnosis:
    other = body.with_parameters(axial_stiffness_scale=1.15)
    recordings = made(other, hidden, sessions=4, measured=measured, process=ahead if early else None)
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


@pytest.mark.parametrize("measured", [False, True])
def test_a_log_whose_commands_act_from_their_row_on_hides_nothing(body: PccSimulator, measured: bool) -> None:
    found = diagnosed(body, (), measured, early=True)
    assert found.verdict == "nothing missing", found.sentences
    assert any(line.startswith("By the log") for line in found.sentences)


def test_a_dead_time_is_no_longer_than_the_pressures_between_rows_tell(body: PccSimulator) -> None:
    """A step that comes at any time between two rows looks the same at both; the body behind it tells."""
    recordings = made(body, (DeadTime(delay_s=0.1),), sessions=4, measured=True, period_s=0.05, noise_m=3e-4)
    found = run(configured(candidates=[*RIVALS, "viscoelasticity"]), body.robot, recordings, body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["dead_time"], found.sentences
    delay = found.effects[0]["parameters"]["delay_s"]
    assert delay["value"] == pytest.approx(0.1, abs=0.01) and delay["low"] <= 0.1 <= delay["high"]
    assert found.errors_mm["heldout"]["corrected"] < 1.05 * found.errors_mm["heldout"]["noise_floor"]


@pytest.mark.parametrize(("measured", "lag_s"), [pytest.param(False, 0.4, marks=pytest.mark.slow), (True, 0.15)])
def test_a_lag_behind_such_a_log_is_no_tube(body: PccSimulator, measured: bool, lag_s: float) -> None:
    found = diagnosed(body, (Lag(fill_s=lag_s, vent_s=lag_s),), measured, early=True)
    assert [effect["name"] for effect in found.effects] == ["lag"]
    assert found.effects[0]["parameters"]["fill_s"]["value"] == pytest.approx(lag_s, abs=0.01)


@pytest.mark.parametrize(
    ("effect", "measured", "process"),
    [pytest.param(VALVE, False, ahead, marks=pytest.mark.slow), (LOAD, False, ahead), (LOAD, True, seen_late)],
)
def test_the_corrected_simulator_is_as_late_as_the_log(
    body: PccSimulator, effect: Effect, measured: bool, process: Callable[[Recording], Recording]
) -> None:
    recordings = made(body, (effect,), sessions=4, measured=measured, process=process)
    found = run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())
    assert found.late_s["corrected"] > 0.5 * INTERVAL_S
    plant = built(found.corrections(), found.simulator_parameters, body.robot, body)
    heldout = [r for r in recordings.recordings if r.name in found.data["heldout_runs"]]
    missed = np.concatenate([r.position - replay(plant, r, 0.01).position for r in heldout])
    alone = 1e3 * float(np.sqrt(np.mean(np.sum(missed**2, axis=1))))
    assert alone == pytest.approx(found.errors_mm["heldout"]["corrected"], rel=0.05)


def test_a_regulator_quicker_than_its_log_does_not_put_the_drive_at_the_wrong_time(body: PccSimulator) -> None:
    hidden = Friction(dry=0.08, loaded=0.05)
    recordings = made(body, (hidden,), sessions=4, measured=True, period_s=0.05, noise_m=3e-4)
    found = run(configured(candidates=["friction", "hysteresis", "play"]), body.robot, recordings, body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["friction"], found.sentences
    assert found.effects[0]["parameters"]["dry"]["value"] == pytest.approx(hidden.dry, rel=0.1)
    assert found.errors_mm["heldout"]["corrected"] < 1.1 * found.errors_mm["heldout"]["noise_floor"]


def test_a_dead_time_before_a_slow_log_is_known_to_within_a_row(body: PccSimulator) -> None:
    recordings = made(body, (DeadTime(delay_s=0.1),), sessions=4, measured=True, period_s=0.05)
    found = run(configured(candidates=["dead_time", "lag"]), body.robot, recordings, body, tracker=NullTracker())
    assert any("up to 50 ms of it, the interval between rows, may be how rows are written" in s for s in found.sentences)
    known = found.effects[0]["parameters"]["delay_s"]
    assert 0.04 <= known["low"] <= 0.1 <= known["high"] <= 0.18, known


@pytest.mark.parametrize("known", [True, False])
def test_a_delay_within_a_row_is_told_where_it_is_known_when_commands_act(body: PccSimulator, known: bool) -> None:
    recordings = made(body, (Delay(delay_s=0.03),), sessions=3, period_s=0.05)
    said = replace(recordings, notes={ACTS: UNTIL} if known else {})
    found = run(configured(candidates=["delay", "gain", "lag"]), body.robot, said, body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["delay"] * known, found.sentences
    assert found.late_s.get("corrected", 0.0) == (0.0 if known else pytest.approx(0.03, abs=0.005))
    if known:
        told = found.effects[0]["parameters"]["delay_s"]
        assert 0.02 < told["low"] <= 0.03 <= told["high"] < 0.04, told
        assert any("rests on the dataset's command_acts: were that wrong, up to 50 ms" in line for line in found.sentences)


def test_a_delay_longer_than_an_interval_is_named_whole(body: PccSimulator) -> None:
    found = diagnosed(body, (Delay(delay_s=0.12),), measured=False, early=False)
    assert "delay" in {effect["name"] for effect in found.effects} | {rival["name"] for rival in found.rivals}
    values = [p["value"] for effect in found.effects for p in effect["parameters"].values()]
    assert values == pytest.approx([0.12], abs=0.01)


def test_a_row_that_acts_later_is_a_later_command(body: PccSimulator) -> None:
    time = INTERVAL_S * np.arange(1, 101)
    pressure = 2e4 * np.random.default_rng(0).random((100, body.robot.chambers))
    plant = Plant(body, chain_of(body.robot, ()))
    early = replay(plant, ahead(Recording("run", "day", time, pressure)), 0.01, late_s=INTERVAL_S)
    straight = replay(plant, Recording("run", "day", time, pressure), 0.01)
    np.testing.assert_allclose(early.position[60:], straight.position[60:], atol=1e-5)


def test_what_shifts_time_itself_leaves_the_log_as_it_is(body: PccSimulator) -> None:
    def room(choice: Choice) -> float:
        return Space(Hypothesis((choice,), (LATE,)), body, 4.0, INTERVAL_S).axes[-1].high

    assert room(Choice("delay")) == room(Choice("dead_time")) == 0.0
    assert room(Choice("lag")) == room(Choice("dead_time", chamber=1)) == INTERVAL_S
    assert room(Choice("delay", gate=Gate("since_s", 3.0))) == INTERVAL_S


def test_a_dead_time_contests_a_delay_where_no_gauge_tells_them_apart(body: PccSimulator) -> None:
    """It has a dispersion besides, of which the data show none: it is compared without it."""
    recordings = made(body, (Delay(delay_s=0.1),), sessions=3)
    found = run(configured(candidates=["delay", "dead_time", "lag"]), body.robot, recordings, body, tracker=NullTracker())
    assert found.verdict == "indistinguishable", found.sentences
    assert {found.effects[0]["name"], *(r["name"] for r in found.rivals if r["equivalent"])} == {"delay", "dead_time"}


def test_a_log_that_is_later_than_a_dead_time_can_be_is_several() -> None:
    for late_s in (0.0, 0.4, 2.5):
        delays = [DeadTime(**entry["parameters"]).delay_s for entry in late(late_s)]
        assert sum(delays) == pytest.approx(late_s)
