"""Laws of feedback on a surface: it takes away what lasts, whatever the surface is like, and never runs away."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.core.config import build, build_target
from softrl.effects.chain import Plant, chain_of
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.rl.inversion import Plan, plan
from softrl.rl.tasks.force import Force
from softrl.rl.tasks.hybrid import Hybrid
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.controller import ModelController
from softrl.sim2real.controllers import Models, prepare, route_of
from softrl.sim2real.course import Course, courses
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.drivers.stub import Ground
from softrl.sim2real.planning import PlannedController, Planning
from softrl.sim2real.rollout import Pace, Rollout, follow
from softrl.sim2real.surface import Surface
from tests.sim2real.conftest import CONF, BenchDriver, surrogate_of, task_numbers

PACE, SHARE = Pace(0.5, 2, 6), 0.5  # of the chambers' area: bends as far, but yields to forces as the tripod does
PLANNING = build(yaml.safe_load((CONF / "stage" / "sim2real.yaml").read_text())["planning"], Planning, "planning")
GROUNDS = {
    "as told": Ground(2000.0, 0.3, 0.0), "nearer": Ground(2000.0, 0.3, 1.0), "much nearer": Ground(2000.0, 0.3, 3.0),
    "farther": Ground(2000.0, 0.3, -1.0), "much farther": Ground(2000.0, 0.3, -3.0), "smooth": Ground(2000.0, 0.0, 0.0),
    "rough": Ground(2000.0, 0.5, 0.0), "soft": Ground(500.0, 0.3, 0.0), "hard": Ground(6000.0, 0.3, 0.0),
}  # fmt: skip


class Bench:
    """A soft robot that presses on a slope, a plan for it, and what the simulation knows of both."""

    def __init__(self, tripod: Robot, policy: Policy, calibration: Calibration) -> None:
        self.robot = replace(tripod, chamber_area_m2=SHARE * tripod.chamber_area_m2)
        node = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
        self.body = build_target(node, "simulator", lambda hint: self.robot if hint is Robot else None)
        space = Workspace(surrogate_of(self.robot, self.body))
        plant = Plant(self.body, chain_of(self.robot, []))
        pressing, sliding = (
            build(task_numbers(kind.name) | {"lap_steps": 24}, kind, "task") for kind in (Force, Hybrid)
        )
        self.models = Models(self.robot, policy, space, pressing, calibration, plant)
        self.sliding = replace(self.models, task=sliding)
        self.course: Course = next(courses(pressing, space))
        self.plan: Plan = prepare(self.models, PLANNING, PACE, self.course)

    def follow(self, ground: Ground, noise: Noise, feedback: float, gone: tuple[int, int] | None = None) -> Rollout:
        """Return a rollout on ``ground``, which is taken away before one step and put back before another."""
        settings, surface = replace(PLANNING, feedback=feedback), self.models.surface
        route = route_of(self.models, settings, PACE, self.course)
        controller = PlannedController(self.plan, PACE.approach_steps, settings, route, self.course)
        driver = BenchDriver(self.robot, self.body, noise)
        assert surface is not None
        driver.surface = ground.mounted(np.array(surface.normal), np.array(surface.point))

        def put(where: Surface) -> None:
            driver.rig._surface = where
            driver.rig._load_hooks[-1].parameters[:] = where.pack(self.robot)

        away = replace(driver.surface, point=(0.0, 0.0, 1.0))
        events = {} if gone is None else {gone[0]: lambda: put(away), gone[1]: lambda: put(driver.surface)}
        return follow(driver, self.robot, controller, self.course, PACE, "press", "press", events)


@pytest.fixture(scope="module")
def bench(tripod: Robot, policy: Policy, calibration: Calibration) -> Bench:
    """Return the bench."""
    return Bench(tripod, policy, calibration)


def test_a_plan_is_nearer_where_it_is_linearised_without_sticking(bench: Bench) -> None:
    course = next(courses(bench.sliding.task, bench.sliding.space))
    start = ModelController(bench.sliding.space, bench.sliding.task, course).pressures
    stuck = plan(route_of(bench.sliding, PLANNING, PACE, course), course.wanted, start, PACE.approach_steps, PLANNING)
    even = prepare(bench.sliding, PLANNING, PACE, course)
    left, kept = (np.linalg.norm(p.predicted - p.target, axis=1) for p in (even, stuck))
    assert np.linalg.norm(left) < 0.5 * np.linalg.norm(kept)


@pytest.mark.parametrize("task", ["pressing", "sliding"])
def test_a_wall_that_slips_and_creeps_is_planned_for(bench: Bench, task: str) -> None:
    models = bench.models if task == "pressing" else bench.sliding
    wall = Hysteresis(height=0.03, yield_strain=0.02), Viscoelasticity(0.0, 1.0, 0.25, 0.8)
    known = replace(models, plant=Plant(bench.body, chain_of(bench.robot, [Lag(fill_s=0.1, vent_s=0.2), *wall])))
    course = next(courses(models.task, models.space))
    prepared = prepare(known, PLANNING, PACE, course)
    left = 1e3 * np.linalg.norm(prepared.predicted - prepared.target, axis=1)[PACE.approach_steps :]
    assert np.sqrt(np.mean(left**2)) < 0.15


@pytest.mark.parametrize("name", GROUNDS)
def test_feedback_is_never_worse_than_the_plan_alone(bench: Bench, silence: Noise, name: str) -> None:
    noise = replace(silence, position_white_mm=0.05, force_white_n=0.02)
    alone, led = (bench.follow(GROUNDS[name], noise, share) for share in (0.0, PLANNING.feedback))
    assert led.error_m() < alone.error_m() + 0.1e-3
    assert led.force_error_n() < alone.force_error_n() + 0.03


@pytest.mark.parametrize("name", ["nearer", "much nearer", "farther", "much farther"])
def test_what_lasts_is_taken_away(bench: Bench, silence: Noise, name: str) -> None:
    alone, led = (bench.follow(GROUNDS[name], silence, share) for share in (0.0, PLANNING.feedback))
    late = slice(len(bench.course.force) // 2, None)
    left, before = (np.abs(run.pressed - bench.course.force)[late].mean() for run in (led, alone))
    assert left < 0.1 * before
    left, before = (bench.course.position_error(run.reached)[late].max() for run in (led, alone))
    assert left < 0.25 * before


def test_where_nothing_differs_feedback_changes_nothing(bench: Bench, silence: Noise) -> None:
    alone, led = (bench.follow(GROUNDS["as told"], silence, share) for share in (0.0, PLANNING.feedback))
    np.testing.assert_allclose(led.reached, alone.reached, atol=2e-5)
    np.testing.assert_allclose(led.pressed, alone.pressed, atol=0.02)


def test_a_surface_that_is_away_for_a_while_winds_nothing_up(bench: Bench, silence: Noise) -> None:
    gone, back = 8, 16
    led = bench.follow(GROUNDS["as told"], silence, PLANNING.feedback, (gone, back))
    assert not led.pressed[gone:back].any()
    assert 1e3 * bench.course.position_error(led.reached)[gone + 3 : back].max() < 1.0, "the tip stays where it is to press"
    assert np.abs(led.pressed - bench.course.force)[back + 2 :].max() < 0.5
