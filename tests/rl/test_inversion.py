"""Plans at the ends of a robot's pressures: probes go where something is sent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.core.config import build_target
from softrl.effects.chain import Plant, chain_of
from softrl.recordings.program import limited
from softrl.rl.inversion import Route, linearise, plan
from softrl.robots.robot import Robot
from tests.rl.test_training import PLANNING

BODY = Path(__file__).parents[2] / "conf" / "simulator" / "pcc.yaml"


@pytest.mark.parametrize(("low", "high"), [(20e3, 60e3), (0.0, 60e3), (-20e3, 35e3)])
def test_a_request_at_an_end_of_the_range_is_planned_as_one_within(robot: Robot, low: float, high: float) -> None:
    quick = replace(robot, pressure_min_pa=low, pressure_max_pa=high, slew_pa_per_s=1e7)
    body = build_target(yaml.safe_load(BODY.read_text()), "simulator", lambda _: quick)
    route = Route(quick, Plant(body, chain_of(quick, ())), 0.5, PLANNING.dt_s, 1, lambda position: position)
    middle, wanted = 0.5 * (low + high), np.random.default_rng(0).uniform(low, high, (4, 3))
    target, size = route.predict(wanted), {}
    for at in (low, middle, high):
        request = np.full_like(wanted, at)
        size[at] = np.abs(linearise(route, request, route.predict(request), PLANNING)).max()
        found = plan(route, target, request, 0, replace(PLANNING, rounds=2, smoothness_mm_per_kpa=1e-3))
        missed = np.linalg.norm(found.predicted - target) / np.linalg.norm(route.predict(request) - target)
        assert missed < 0.1, f"from {at:g} Pa {missed:.2f} of the error is left"
    assert min(size.values()) > 0.2 * size[middle], size


@pytest.mark.parametrize(("low", "high"), [(20e3, 60e3), (-60e3, -20e3), (-20e3, 35e3)])
def test_a_vented_robot_is_sent_what_programs_send(robot: Robot, low: float, high: float) -> None:
    slow = replace(robot, pressure_min_pa=low, pressure_max_pa=high, slew_pa_per_s=1e4)
    body = build_target(yaml.safe_load(BODY.read_text()), "simulator", lambda _: robot)
    route = Route(slow, Plant(body, chain_of(robot, ())), 0.5, 0.01, 1, lambda position: position)
    wanted = np.linspace(low, high, slow.chambers)
    program = limited(slow, np.tile(wanted, (route.hold, 1)), route.step_s)
    np.testing.assert_allclose(route.sent(np.zeros(slow.chambers), wanted), program)
