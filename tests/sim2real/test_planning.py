"""Laws of planned commands: they invert what is known, feedback takes away what is not, limits hold."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.span import held
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.offset import Offset
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.rl.filter import MovingAverage
from softrl.rl.inversion import Plan, Route, linearise, plan
from softrl.rl.running import Run
from softrl.robots.robot import Robot
from softrl.sim2real.course import Course
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.planning import PlannedController, Planning
from softrl.sim2real.rollout import Pace, follow
from softrl.sim2real.watch import Watch
from tests.sim2real.conftest import BenchDriver
from tests.sim2real.test_missing import Blinking

PERIOD_S, APPROACH, STEPS = 0.5, 2, 14
SETTINGS = Planning(
    dt_s=0.01, memory_steps=4, probe_kpa=0.2, rounds=2, refinements=2, smoothness_mm_per_kpa=0.01,
    approach_weight=0.1, feedback=0.5, horizon_steps=3, watch=Watch(settle_s=2.0, fault_kpa=3.0, after_s=0.4, afresh_steps=3),
)  # fmt: skip
HIDDEN = (Lag(fill_s=0.15, vent_s=0.3), Hysteresis(height=0.03, yield_strain=0.02))
CREEP = Viscoelasticity(share_1=0.25, relaxation_1_s=0.8, share_2=0.0, relaxation_2_s=20.0)
CAMERA = Noise(
    position_white_mm=0.05, position_coloured_mm=0.05, colour_s=1.0, orientation_white_deg=0.02,
    pressure_white_kpa=0.02, force_white_n=0.02, dropped_share=0.005,
)  # fmt: skip


def route(robot: Robot, body: Simulator, *effects: Effect) -> Route:
    return Route(robot, Plant(body, chain_of(robot, effects)), PERIOD_S, SETTINGS.dt_s, 2, lambda position: position)


@pytest.fixture(scope="module")
def guess() -> np.ndarray:
    """Return pressures (steps, 3) Pa of a smooth loop."""
    phase = 2.0 * np.pi * np.arange(STEPS) / STEPS
    return 12e3 + 6e3 * np.column_stack([np.sin(phase), np.cos(phase), np.sin(phase + 2.0)])


@pytest.fixture(scope="module")
def target(tripod: Robot, body: Simulator, guess: np.ndarray) -> np.ndarray:
    """Return tips (steps, 3) m at rest under those pressures."""
    settled = (body.step(body.reset(), row, 1e6) for row in guess)
    return np.stack([body.observe(state)[0] for state in settled])


def planned(route: Route, target: np.ndarray, guess: np.ndarray) -> Plan:
    return plan(route, target, guess, APPROACH, SETTINGS)


def controller_of(prepared: Plan, known: Route, settings: Planning = SETTINGS) -> PlannedController:
    return PlannedController(prepared, APPROACH, settings, known, Course.free("loop", prepared.target[APPROACH:]))


def error_mm(controller: Any, robot: Robot, body: Simulator, noise: Noise, target: np.ndarray, *hidden: Effect) -> float:
    driver = BenchDriver(robot, body, noise, hidden)
    rollout = follow(driver, robot, controller, Course.free("loop", target), Pace(PERIOD_S, 2, APPROACH), "loop", "loop")
    return 1e3 * rollout.error_m()


def test_known_physics_is_inverted_without_feedback(
    tripod: Robot, body: Simulator, silence: Noise, target: np.ndarray, guess: np.ndarray
) -> None:
    blind = replace(SETTINGS, feedback=0.0)

    def run(known: Route) -> float:
        controller = controller_of(planned(known, target, guess), known, blind)
        return error_mm(controller, tripod, body, silence, target, *HIDDEN)

    nominal = run(route(tripod, body))
    corrected = run(route(tripod, body, *HIDDEN))
    assert corrected < 0.15 * nominal
    assert corrected < 0.5


def test_feedback_takes_away_what_nobody_knew(
    tripod: Robot, body: Simulator, silence: Noise, target: np.ndarray, guess: np.ndarray
) -> None:
    known = route(tripod, body)
    prepared = planned(known, target, guess)
    hidden = Offset(offset=0.04, chamber=0)
    blind, seeing = (
        error_mm(
            controller_of(prepared, known, replace(SETTINGS, feedback=share)), tripod, body, silence, target, hidden
        )
        for share in (0.0, 0.5)
    )
    assert seeing < 0.35 * blind


def test_the_prediction_is_what_the_rig_does(
    tripod: Robot, body: Simulator, silence: Noise, target: np.ndarray, guess: np.ndarray
) -> None:
    course = route(tripod, body)
    request = np.concatenate([guess[:1], guess])
    predicted = course.predict(request)

    class Playing:
        def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
            return request[step + 1]

    driver = BenchDriver(tripod, body, silence)
    rollout = follow(driver, tripod, Playing(), Course.free("play", target), Pace(PERIOD_S, 2, 1), "play", "play")
    np.testing.assert_allclose(rollout.reached, predicted[1:], atol=5e-5)


def test_a_reading_from_before_is_not_learnt_from(
    tripod: Robot, body: Simulator, silence: Noise, target: np.ndarray, guess: np.ndarray
) -> None:
    known, driver = route(tripod, body), Blinking(tripod, body, silence)
    driver.blind, driver.stale_s = (lambda time_s: 4.0 < time_s < 5.2), 2.0
    controller = controller_of(planned(known, target, guess), known)
    rollout = follow(driver, tripod, controller, Course.free("loop", target), Pace(PERIOD_S, 2, APPROACH), "loop", "loop")
    error = np.linalg.norm(rollout.reached - target, axis=1)
    assert 1e3 * error[-6:].max() < 0.1, "seen again"


def test_probes_together_tell_what_each_would_tell_alone(tripod: Robot, body: Simulator, guess: np.ndarray) -> None:
    course = route(tripod, body)
    predicted = course.predict(guess)
    together = linearise(course, guess, predicted, SETTINGS)
    changed = guess.copy()
    changed[5, 1] -= 200.0
    alone = (course.predict(changed) - predicted)[5:8] / -200.0
    stacked = np.stack([together[5 + j, :, j, 1] for j in range(3)])
    np.testing.assert_allclose(stacked, alone, atol=0.03 * np.abs(alone).max())


def test_a_plan_beyond_the_range_stays_within_it(tripod: Robot, body: Simulator, guess: np.ndarray) -> None:
    far = body.observe(body.step(body.reset(), np.array([60e3, 0.0, 0.0]), 1e6))[0]
    known = route(tripod, body)
    prepared = planned(known, np.tile(far, (4, 1)), guess[:4])
    assert prepared.request.max() <= tripod.pressure_max_pa + 1e-3
    assert prepared.request.min() >= tripod.pressure_min_pa - 1e-3
    controller = controller_of(prepared, known)
    for step in range(-APPROACH, 4):
        sent = controller.pressure(np.zeros(3), step)
        assert sent.max() <= tripod.pressure_max_pa + 1e-3, "a misfit that cannot be removed does not wind up"


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"feedback=1\.5"):
        replace(SETTINGS, feedback=1.5)
    with pytest.raises(ConfigError, match="memory_steps=0"):
        replace(SETTINGS, memory_steps=0)


def cut_and_back(
    known: Route, noise: Noise, prepared: Plan, target: np.ndarray, watch: Watch,
    hidden: tuple[Effect, ...] = HIDDEN, chamber: int = 0, seed: int = 0, off: int = 5,
) -> tuple[np.ndarray, int]:  # fmt: skip
    """Return the errors (steps,) mm while a line is ``off`` for as many steps, and the step before which it is back."""
    cut, back = STEPS, STEPS + off
    robot = known.robot
    driver = BenchDriver(robot, known.plant.simulator, noise, hidden, seed)
    controller = controller_of(prepared, known, replace(SETTINGS, watch=watch))
    course, events = Course.free("loop", target), {cut: lambda: driver.cut(chamber), back: lambda: driver.cut(None)}
    rollout = follow(driver, robot, controller, course, Pace(PERIOD_S, 2, APPROACH), "loop", "loop", events)
    return 1e3 * course.position_error(rollout.reached), back


def test_a_line_that_was_off_is_not_made_up_for(
    tripod: Robot, body: Simulator, silence: Noise, target: np.ndarray, guess: np.ndarray
) -> None:
    laps = np.tile(target, (3, 1))
    known = route(tripod, body, *HIDDEN)
    prepared = planned(known, laps, np.tile(guess, (3, 1)))
    blind = replace(SETTINGS.watch, fault_kpa=1e3)
    wound_up, back = cut_and_back(known, silence, prepared, laps, blind)
    watched, _ = cut_and_back(known, silence, prepared, laps, SETTINGS.watch)
    np.testing.assert_array_equal(watched[:STEPS], wound_up[:STEPS], "a whole line is not taken for a broken one")
    assert watched[back:].max() < 0.5 * wound_up[back:].max()
    within_2_s = back + round(2.0 / PERIOD_S) - 1
    assert watched[within_2_s] < 0.05 * wound_up[back:].max()


@pytest.fixture(scope="module")
def creeping(tripod: Robot, body: Simulator, target: np.ndarray, guess: np.ndarray) -> tuple[Route, Plan, np.ndarray]:
    """Return the way to a creeping robot that is known as a diagnosis knows it, three laps planned on it, and their targets."""
    nearly = (Lag(fill_s=0.16, vent_s=0.31), replace(CREEP, share_1=0.256, relaxation_1_s=0.74), HIDDEN[1])
    known, laps = route(tripod, body, *nearly), np.tile(target, (3, 1))
    return known, planned(known, laps, np.tile(guess, (3, 1))), laps


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_robot_that_creeps_is_back_within_2_s(creeping: tuple[Route, Plan, np.ndarray], seed: int) -> None:
    known, prepared, laps = creeping
    hidden = (HIDDEN[0], CREEP, HIDDEN[1])
    error, back = cut_and_back(known, CAMERA, prepared, laps, SETTINGS.watch, hidden, chamber=seed, seed=seed, off=10)
    assert error[STEPS + 2 : back].min() > 3.0, "the line was missed"
    within_2_s = back + round(2.0 / PERIOD_S) - 1
    assert error[within_2_s:].max() < 0.05 * error[:back].max(), f"{np.round(error[back:], 2)} mm after the line is back"


def test_a_simulation_that_is_told_of_a_fault_knows_what_it_leaves_behind(
    tripod: Robot, body: Simulator, silence: Noise, guess: np.ndarray
) -> None:
    hidden = (HIDDEN[0], CREEP, HIDDEN[1])
    known = route(tripod, body, *hidden)
    told, untold = Run(known), Run(known)
    apart = 0.0
    with BenchDriver(tripod, body, silence, hidden) as driver:
        driver.advance(PERIOD_S)
        average = MovingAverage(2)
        for step, request in enumerate(guess):
            driver.cut(0 if 3 <= step < 9 else None)
            driver.command(average.advance(request))
            arrived = driver.advance(PERIOD_S)
            for run in (told, untold):
                run.advance(request)
            if 3 <= step < 10:  # the line fills in the last of these
                behind = np.full((known.hold, tripod.chambers), np.nan)
                behind[:, 0] = [sample.pressure[0] for sample in arrived]
                told.amend(held(behind))
            reached = arrived[-1].position
            apart = max(apart, miss_mm(told, reached))
            if step == 9:
                assert miss_mm(untold, reached) > 1.0, "without it the wall's memory is missing"
    assert apart < 0.1, f"{apart:.3f} mm from the robot"


def miss_mm(run: Run, reached: np.ndarray) -> float:
    return 1e3 * float(np.linalg.norm(run.tip - reached))
