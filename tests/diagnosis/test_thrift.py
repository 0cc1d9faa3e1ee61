"""What is kept or shared between simulations changes nothing, to the last bit."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from softrl.diagnosis.fitting.bins import Bins
from softrl.diagnosis.fitting.bodies import tuned_body
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.minimise import Fit, jacobian_at, least_squares
from softrl.diagnosis.fitting.problem import REPLAYS, Numerics, Problem
from softrl.diagnosis.fitting.trial import Trial, fit_trials, shared_out
from softrl.diagnosis.search.look import Base, hidden_by_retuning, look_at
from softrl.diagnosis.search.rank import rank
from softrl.diagnosis.telling.separate import PIECES, REST_S, STEP_S, _rival, gap, separating_program, separation
from softrl.effects.chain import Plant, chain_of
from softrl.effects.lag import Lag
from softrl.effects.replay import CHANNELS, replay
from softrl.excite.block import blocks
from softrl.excite.separation import Sensing
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.gone import Now
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made

NUMERICS = Numerics(0.02, 0.04, 0.1, 0.0, 4.0)
NOW = Now("mon", (0.0, 60.0, 200.0))


def problem_of(robot: Robot, body: PccSimulator) -> Problem:
    runs = made(body, (Lag(fill_s=0.1, vent_s=0.1),), sessions=3).recordings
    return Problem(robot, body, runs, NUMERICS, "motion", "command", False, False)


def test_shared_effects_and_kept_bodies_replay_as_those_made_for_every_run(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    tuned = tuple(body.parameters)
    alone = Choice("payload", sessions=(problem.runs[1].session,))
    hypothesis = Hypothesis((Choice("lag"), alone), tuned)
    point = np.concatenate([starts(Choice("lag"))[0], starts(alone)[0], np.full(len(tuned), 0.1)])
    space = problem.space(hypothesis)
    for _ in range(2):  # the second time the body is a kept one
        shared = problem.replayed(hypothesis, point)
        for run, found in zip(problem.runs, shared, strict=True):
            fresh = body.with_parameters(**space.tuned(point))
            plant = Plant(fresh, chain_of(tripod, space.effects(point, run.session)))
            np.testing.assert_array_equal(found.position, replay(plant, run, NUMERICS.dt_s).position)
    assert not np.array_equal(space.effects(point, problem.runs[0].session), space.effects(point, problem.runs[1].session))


def test_a_kept_body_belongs_to_one_simulator(tripod: Robot, body: PccSimulator) -> None:
    other = replace(body, damping_s=2.0 * body.damping_s)
    values = {"mass_scale": 1.3}
    one, two = (tuned_body(simulator, values, 0.0) for simulator in (body, other))
    assert one == body.with_parameters(mass_scale=1.3) and two == other.with_parameters(mass_scale=1.3)
    assert tuned_body(body, values, 0.0) is one
    assert tuned_body(body, {}, 0.0) is body
    softer = tuned_body(body, {"bending_stiffness_scale": 1.0, "mass_scale": 1.3}, -0.02)
    assert softer == body.with_parameters(bending_stiffness_scale=0.98, mass_scale=1.3)


def test_bins_hold_means(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    run, values = problem.runs[0], np.asarray(problem.runs[0].position)
    found = problem.binned(0, values)
    number = problem.bins[0].number
    for k in (0, 7, int(number[-1])):
        np.testing.assert_allclose(found[k], values[number == k].mean(axis=0), rtol=1e-12)
    assert len(found) == len(set(((run.time - run.time[0]) / NUMERICS.bin_s).astype(int)))


def test_bins_hold_what_is_said_to_be_left_of_noise(tripod: Robot, body: PccSimulator) -> None:
    rng, periods = np.random.default_rng(5), (0.01, 0.03, 0.1)
    times = [period * np.arange(round(200.0 / period)) for period in periods]
    runs = tuple(Recording(f"{k}", "day", time, np.zeros((len(time), 3))) for k, time in enumerate(times))
    problem = replace(problem_of(tripod, body), runs=runs)
    squares = [(problem.binned(k, rng.standard_normal((len(time), 8))) ** 2).mean(axis=1) for k, time in enumerate(times)]
    assert problem.floor(1.0, 0.0) == pytest.approx(np.sqrt(np.concatenate(squares).mean()), rel=0.03)
    for k, own in enumerate(squares):
        assert problem.on(runs[k : k + 1]).floor(1.0, 0.0) == pytest.approx(np.sqrt(own.mean()), rel=0.03)
    assert problem.floor(1.0, 2.0) == 2.0


@pytest.mark.parametrize("began_s", [0.0, 1.7e9])
def test_rows_as_slow_as_bins_have_one_each(began_s: float) -> None:
    bins = Bins(began_s + 0.1 * np.arange(750), 0, 0.1, np.ones(750, dtype=bool))
    np.testing.assert_array_equal(bins.places, np.arange(750))


def test_long_steps_are_corrected_where_they_are_told_to(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    hypothesis, point = Hypothesis((Choice("lag"),), ()), starts(Choice("lag"))[0]
    rough, about = problem.rough, problem.rough_about(hypothesis, point)
    np.testing.assert_allclose(about.residual(hypothesis, point).flat, problem.residual(hypothesis, point).flat, atol=1e-12)
    assert about.numerics.dt_s == NUMERICS.rough_dt_s
    near = 1.05 * point
    true = problem.residual(hypothesis, near).flat
    errors = [np.linalg.norm(other.residual(hypothesis, near).flat - true) for other in (rough, about)]
    assert errors[1] < 0.2 * errors[0], "near by, long steps hardly err any more"


def test_what_retuning_does_nearly_all_of_is_told(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    tuned = tuple(body.parameters)
    space = problem.space(Hypothesis((), tuned))
    for far, mistaken in ((0.3, True), (0.0, False)):
        point = np.full(len(tuned), far)
        value = problem.residual(space.hypothesis, point).flat
        jacobian = jacobian_at(lambda u: problem.residual(space.hypothesis, u).flat, point, value, *space.bounds, 0.02)
        trial = Trial(space.hypothesis, Fit(point, value, jacobian, 0.5 * float(value @ value), 0), {}, value**2, value**2)
        base = Base(trial, np.linalg.qr(jacobian)[0])
        for name, alike in (("payload", False), ("gain", True)):  # a gain is another stiffness, but for the weight
            look = look_at(problem, [base], Choice(name), starts(Choice(name)), False, [{}])
            assert hidden_by_retuning(base, look.known[0]) is (mistaken and alike), name


def test_a_replay_asked_for_again_is_the_same_and_other_processes_do_not_carry_it(
    tripod: Robot, body: PccSimulator
) -> None:
    problem, hypothesis = problem_of(tripod, body), Hypothesis((Choice("lag"),), ())
    points = [starts(Choice("lag"))[0] * share for share in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)]
    first = [problem.residual(hypothesis, point).flat for point in points]
    assert len(problem._known) == REPLAYS
    again = [problem.residual(hypothesis, point).flat for point in reversed(points)]
    for one, two in zip(first, reversed(again), strict=True):
        np.testing.assert_array_equal(one, two)
    sent = pickle.loads(pickle.dumps(problem))
    assert "_known" not in sent.__dict__
    np.testing.assert_array_equal(sent.residual(hypothesis, points[0]).flat, first[0])


def test_a_fit_that_shares_out_its_columns_is_the_fit_alone(
    tripod: Robot, body: PccSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softrl.diagnosis.fitting.trial.PccSimulator", type(None))  # which is too fast to share out
    problem, hypothesis = problem_of(tripod, body), Hypothesis((Choice("lag"),), tuple(body.parameters))
    held, (low, high) = starts(Choice("lag"))[0], problem.space(hypothesis).bounds
    count = len(held)

    def residual(free: np.ndarray) -> np.ndarray:
        return problem.residual(hypothesis, np.r_[held, free]).flat

    given = np.zeros(len(low) - count), low[count:], high[count:], 3
    one = least_squares(residual, *given)
    two = least_squares(residual, *given, several=shared_out(problem, hypothesis, 2, held))
    np.testing.assert_array_equal(two.point, one.point)
    np.testing.assert_array_equal(two.jacobian, one.jacobian)


def test_channels_alone_are_those_of_a_whole_replay(tripod: Robot, body: PccSimulator) -> None:
    run = replace(made(body, sessions=1).recordings[0], bend_angle=np.zeros(1))
    plant = Plant(body, chain_of(tripod, (Lag(fill_s=0.1, vent_s=0.2),)))
    whole = replay(plant, run, 0.02)
    for wanted in (("position",), ("pressure_meas",), ("bend_angle",), ("position", "quaternion")):
        part = replay(plant, run, 0.02, channels=wanted)
        for name in CHANNELS:
            if name in wanted:
                np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))
            else:
                assert getattr(part, name) is None


def test_the_pieces_that_tell_two_hypotheses_apart_are_the_best_of_all(
    tripod: Robot, body: PccSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("softrl.diagnosis.telling.separate.blocks", lambda *given: blocks(*given)[::4])
    problem = problem_of(tripod, body)
    trials = []
    for name in ("lag", "tube_line"):
        hypothesis, point = Hypothesis((Choice(name),), ("damping_s",)), np.r_[starts(Choice(name))[0], 0.0]
        fit = Fit(point, np.zeros(1), np.zeros((1, len(point))), 0.0, 1)
        trials.append(Trial(hypothesis, fit, {}, np.zeros(1), np.zeros(1)))
    found = separating_program(problem, *trials, noise_m=np.sqrt(3.0) * 1e-4, now=NOW)  # of three coordinates together
    one, other = (_rival(problem, trial, NOW) for trial in trials)
    sensing = Sensing(STEP_S, NUMERICS.bin_s, 1e-4, None)
    pieces = blocks(tripod, STEP_S, REST_S, 0)[::4]
    apart = np.array([separation(one, other, piece.pressure, sensing) for piece in pieces])
    assert all(gap(one, other, p.pressure, sensing) >= a for p, a in zip(pieces, apart, strict=True))
    best = np.argsort(-(apart**2) / [len(piece.pressure) for piece in pieces])[:PIECES]
    assert found is not None and found["program"] == "; then ".join(pieces[k].label for k in best)
    np.testing.assert_allclose(found["separation"], np.linalg.norm(apart[best]))


def test_what_is_over_tells_nothing_apart_and_what_lasts_goes_on(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    trials = []
    for choice in (Choice("payload", sessions=("tue",)), Choice("drift", sessions=("tue",), lasting="ever")):
        point = np.r_[starts(choice)[0], 0.0]
        fit = Fit(point, np.zeros(1), np.zeros((1, len(point))), 0.0, 1)
        trials.append(Trial(Hypothesis((choice,), ("damping_s",)), fit, {}, np.zeros(1), np.zeros(1)))
    assert separating_program(problem, *trials, noise_m=1e-4, now=NOW) is None
    tuesday = NOW._replace(session="tue")
    assert _rival(problem, trials[1], tuesday).effects[0].begun_s == NOW.gone_s[-1]
    found = separating_program(problem, *trials, noise_m=1e-4, now=tuesday)
    assert found is not None and found["separation"] > 1.0


def test_how_many_processes_rank_changes_nothing(tripod: Robot, body: PccSimulator) -> None:
    problem = problem_of(tripod, body)
    tuned = tuple(body.parameters)
    search = configured(search={"workers": 1}).search
    current = fit_trials(problem, None, [(Hypothesis((), tuned), [])], search)[0]
    choices = [Choice(name) for name in ("lag", "payload", "gain", "tether")]
    one, two = (rank(problem, current, choices, replace(search, workers=workers)) for workers in (1, 2))
    for alone, shared in zip(one, two, strict=True):
        assert (alone.choice, alone.gain) == (shared.choice, shared.gain)
        np.testing.assert_array_equal(alone.point, shared.point)


def test_no_piece_is_asked_for_that_tells_nothing_apart(
    tripod: Robot, body: PccSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three pieces one alone drives the chamber of which it is asked whether it lags."""
    kept = ("hold of 15 s at full pressure, chamber 1", "hold of 15 s at full pressure, chamber 2", "rest of 20 s")
    monkeypatch.setattr(
        "softrl.diagnosis.telling.separate.blocks", lambda *given: [piece for piece in blocks(*given) if piece.label in kept]
    )
    trials = []
    for choice in (Choice("lag", 0), Choice("gain", 0)):
        hypothesis, point = Hypothesis((choice,), ("damping_s",)), np.r_[starts(choice)[0], 0.0]
        fit = Fit(point, np.zeros(1), np.zeros((1, len(point))), 0.0, 1)
        trials.append(Trial(hypothesis, fit, {}, np.zeros(1), np.zeros(1)))
    found = separating_program(problem_of(tripod, body), *trials, noise_m=1e-4, now=NOW)
    assert found is not None and found["program"] == kept[0] and found["duration_s"] == pytest.approx(15.0 + REST_S, abs=0.5)
