"""The environments: checkers, seeds, reward, curves within reach, the expert."""

import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import yaml
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build_target
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.tracking import NullTracker
from softrl.rl.batch import Batch
from softrl.rl.env import ENVIRONMENTS
from softrl.rl.evaluate import evaluate, expert, open_loop, rest
from softrl.rl.figures import draw_reward
from softrl.rl.reward import weigh
from softrl.rl.sweep import pareto_front
from softrl.rl.tasks.curves import CURVES, random_fourier
from softrl.rl.tasks.task import Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.surrogate.springs import constant
from softrl.surrogate.stage import build_surrogate
from tests.surrogate.conftest import lumped_body, tiny_config

TASKS = tuple(ENVIRONMENTS)
CONF = Path(__file__).parents[2] / "conf" / "task"


def task_of(name: str, **changes: float) -> Task:
    """Return a task of conf/ with some numbers changed."""
    node = yaml.safe_load((CONF / f"{name}.yaml").read_text())
    return build_target(node | {"alpha": 0.5} | changes, "task")


@pytest.mark.parametrize("name", TASKS)
def test_the_checkers_are_content(name: str, surrogate: Surrogate) -> None:
    env = gym.make(ENVIRONMENTS[name], surrogate=surrogate, task=task_of(name), curves=3, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
        check_env_sb3(env.unwrapped)
    env.reset(seed=0)
    picture = env.render()
    assert picture.ndim == 3 and picture.dtype == np.uint8 and np.ptp(picture) > 100


def test_an_id_takes_its_own_task_only(surrogate: Surrogate) -> None:
    with pytest.raises(ConfigError, match="Track"):
        gym.make(ENVIRONMENTS["hybrid"], surrogate=surrogate, task=task_of("track"), curves=2)


def test_a_seed_gives_the_same_episode(space: Workspace) -> None:
    task = task_of("track")
    goals = task.training_goals(4, space, np.random.default_rng(0))
    action = np.random.default_rng(1).uniform(-1, 1, (50, 5, 3))
    runs = []
    for _ in range(2):
        env = TwinVecEnv(Batch(task, space, goals, 5), seed=7)
        rows = [env.reset()]
        for a in action:
            env.step_async(a)
            rows.append(env.step_wait()[0])
        runs.append(np.stack(rows))
    np.testing.assert_array_equal(*runs)


def test_the_front_holds_the_points_that_none_beats_in_both() -> None:
    points = np.random.default_rng(0).uniform(size=(40, 2))
    points[7] = points[3]  # of two equal ones either may stand for both
    front = pareto_front(*points.T)
    for k, point in enumerate(points):
        beaten = ((points <= point).all(axis=1) & (points < point).any(axis=1)).any()
        assert (k in front) == (not beaten) or k in (3, 7)
    assert (np.diff(points[front, 0]) > 0.0).all() and (np.diff(points[front, 1]) < 0.0).all()


def test_the_drawn_shapes_are_what_a_task_pays() -> None:
    task = task_of("hybrid", alpha=0.3)
    position, force = (axis.lines[0] for axis in draw_reward(task).axes)
    x, y = position.get_data()
    paid = task.reward(1e-3 * x, np.full_like(x, 1e3))  # a force far off pays nothing
    np.testing.assert_allclose(paid, 0.3 * y, atol=1e-9)
    x, y = force.get_data()
    np.testing.assert_allclose(task.reward(np.full_like(x, 1e3), x), 0.7 * y, atol=1e-9)


def test_the_reward_is_bounded_and_falls_with_either_error() -> None:
    error = np.linspace(0.0, 0.1, 50)
    for alpha in (0.0, 0.3, 1.0):
        near, firm = weigh(alpha, error, 0.0 * error, 2e-3, 0.3), weigh(alpha, 0.0 * error, error, 2e-3, 0.3)
        for reward in (near, firm):
            assert reward[0] == pytest.approx(1.0) and (reward >= 0.0).all() and (np.diff(reward) <= 0.0).all()


@pytest.mark.parametrize("name", TASKS)
def test_goals_are_within_reach_and_unseen(name: str, space: Workspace) -> None:
    task = task_of(name)
    training = task.training_goals(3, space, np.random.default_rng(0))
    assert space.reachable(training.position.reshape(-1, 3)).mean() > 0.97
    for curve in task.curves:
        goals = task.evaluation_goals(curve, space)
        assert space.reachable(goals.position[0]).all()
        plane = task.plane(space)
        if plane is not None:
            np.testing.assert_allclose((goals.position[0] - plane[1]) @ plane[0], 0.0, atol=1e-12)


@pytest.mark.parametrize("name", TASKS)
def test_the_expert_is_near_and_rest_is_not(name: str, space: Workspace) -> None:
    task = task_of(name, lap_steps=40, friction_coefficient=0.0) if name != "track" else task_of(name, lap_steps=40)
    goals = task.evaluation_goals(task.curves[0], space)
    good, bad = evaluate(expert, task, space, goals, 2), evaluate(rest, task, space, goals, 2)
    assert good.position_rmse < 3e-4 and good.reward > 0.9 > bad.reward
    if name != "track":
        assert good.force_mae < 0.05 < bad.force_mae


@pytest.mark.parametrize(("name", "slope_deg"), [("force", 40.0), ("hybrid", 40.0), ("force", -30.0)])
def test_the_expert_presses_right_where_the_tip_sticks(name: str, slope_deg: float, space: Workspace) -> None:
    task = task_of(name, lap_steps=40, slope_deg=slope_deg, friction_coefficient=0.6)
    found = evaluate(expert, task, space, task.evaluation_goals(task.curves[0], space), 2)
    assert found.force_mae < 0.01 and found.position_rmse < 1e-4, f"{found.force_mae:.3f} N, {1e3 * found.position_rmse:.2f} mm"


def test_the_expert_presses_right_on_a_body_that_hardly_stretches(
    surrogate: Surrogate,
) -> None:
    """Held by friction its tip is far stiffer than free."""
    soft = constant(surrogate.joint_stiffness * [0.3, 0.3, 2.0])
    stiff = Workspace(replace(surrogate, softness_coefficients=soft, gap_share=np.ones(surrogate.gaps)))
    task = task_of("hybrid", lap_steps=40)
    found = evaluate(expert, task, stiff, task.evaluation_goals("circle", stiff), 2)
    assert found.force_mae < 0.01 and found.position_rmse < 1e-4, f"{found.force_mae:.3f} N, {1e3 * found.position_rmse:.2f} mm"


def test_a_hidden_force_moves_tips_and_the_expert_takes_its_share_back(space: Workspace) -> None:
    gain = 0.75
    task = task_of("track", lap_steps=30, feedback_gain=gain)
    goals = task.evaluation_goals("circle", space)
    push = np.tile([0.2, -0.1, 0.0], (2, 1))
    blind = (
        evaluate(open_loop, task, space, goals, 2, push).tip[5:] - evaluate(open_loop, task, space, goals, 2).tip[5:]
    )
    seeing = evaluate(expert, task, space, goals, 2, push)
    left = np.linalg.norm(seeing.tip[5:] - seeing.target[5:], axis=-1)
    np.testing.assert_allclose(left, (1.0 - gain) * np.linalg.norm(blind, axis=-1), rtol=0.15)


@pytest.mark.parametrize("name", ["force", "hybrid"])
def test_on_a_slope_a_gain_that_would_do_nothing_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"task\.feedback_gain=0\.5 is an unknown key"):
        task_of(name, feedback_gain=0.5)


def test_a_task_that_pays_for_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match="alpha=0 pays task=track for nothing"):
        task_of("track", alpha=0.0)
    assert task_of("hybrid", alpha=0.0).alpha == 0.0


def test_forces_that_the_tip_is_not_made_for_are_refused_or_told(
    space: Workspace, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("force", "hybrid"):
        with pytest.raises(ConfigError, match=r"task.force_max_n=2 .*expected at most robot.tip_force_max_n=0.1"):
            task_of(name).check_forces(0.1, space)
        task_of(name, force_min_n=0.02, force_max_n=0.1).check_forces(0.1, space)
        assert "without pressure the tip presses on" in caplog.text and "robot.tip_force_max_n=0.1" in caplog.text
    caplog.clear()
    task_of("force").check_forces(1e3, space)
    task_of("track").check_forces(0.6, space)
    assert not caplog.text
    task_of("track").check_forces(0.5, space)
    assert "task.disturbance_n=0.6 hides forces on a tip that is made for 0.5 N" in caplog.text


def test_a_rough_slope_is_met_anew_and_the_same_in_every_evaluation(space: Workspace) -> None:
    known, rough = (task_of("hybrid", lap_steps=20, roughness_m=r, friction_spread=s) for r, s in ((0.0, 0.0), (5e-4, 1.0)))
    goals = known.evaluation_goals("circle", space)
    first, again = (evaluate(open_loop, rough, space, goals, 2) for _ in range(2))
    np.testing.assert_array_equal(first.tip, again.tip)
    sure = evaluate(open_loop, known, space, goals, 2)
    assert first.force_rmse > sure.force_rmse + 0.1
    plane = rough.plane(space)
    (normal, points), grip = rough.ground(plane, 500, np.random.default_rng(0))
    height = (points - plane[1]) @ normal
    assert 0.4e-3 < np.abs(height).max() <= 0.5e-3 and 0.0 <= grip.min() < 0.03 and 0.57 < grip.max() <= 0.6
    assert known.ground(plane, 500, np.random.default_rng(0)) == (plane, known.friction)


def test_each_tip_may_meet_a_plane_and_a_friction_of_its_own(space: Workspace) -> None:
    normal, point = task_of("hybrid").plane(space)
    theta = space.twin.joints_for_tip(space.centre + np.array([[4e-3, 0.0, 2e-3], [0.0, 5e-3, 3e-3]]))
    start, grip = space.twin.tip(theta) + np.array([2e-3, 0.0, 0.0]), np.array([0.1, 0.5])
    points = point + np.outer([0.0, 4e-4], normal)
    both = space.twin.solve(theta, None, (normal, points), grip, start)
    for i in range(2):
        one = space.twin.solve(theta[i : i + 1], None, (normal, points[i]), float(grip[i]), start[i : i + 1])
        np.testing.assert_array_equal(both.tip[i], one.tip[0])


def test_the_expert_presses_less_where_friction_is_unknown_and_position_counts(space: Workspace) -> None:
    asked = {}
    for alpha in (0.1, 0.9):
        task = task_of("hybrid", lap_steps=40, alpha=alpha, roughness_m=5e-4, friction_spread=1.0)
        goals = task.evaluation_goals("circle", space)
        asked[alpha] = evaluate(expert, task, space, goals, 4)
        known = replace(task, roughness_m=0.0, friction_spread=0.0)
        sure = evaluate(expert, known, space, goals, 2)
        assert sure.position_rmse < 1e-4 and sure.force_rmse < 0.02  # both at once, whatever alpha is
    assert asked[0.9].contact_force.mean() < 0.7 * asked[0.1].contact_force.mean()
    assert asked[0.9].position_rmse < 0.7 * asked[0.1].position_rmse
    assert asked[0.9].force_rmse > asked[0.1].force_rmse + 0.1


def test_curves_close_and_have_unit_size() -> None:
    for curve in CURVES.values():
        points = curve(400)
        assert np.linalg.norm(points, axis=1).max() == pytest.approx(1.0, abs=0.05)
        assert np.linalg.norm(points[0] - points[-1]) < 0.03
    wave = random_fourier(100, 4, 0.5, np.random.default_rng(0))
    assert np.linalg.norm(wave, axis=1).max() == pytest.approx(1.0)


def test_what_is_out_of_reach_is_refused(space: Workspace) -> None:
    space.require(space.surrogate.sample_tip[:5], "samples")
    with pytest.raises(ConfigError, match="trajectory far: 1 of 2 points are out of reach, the first \\(number 1\\)"):
        space.require(space.centre + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]), "far")
    task_of("hybrid").require_reach(space)


def test_a_curve_no_larger_than_the_tolerance_is_refused(robot: Robot) -> None:
    two = replace(robot, name="two", chamber_angle_deg=(0.0, 90.0))  # its tip moves on a surface
    space = Workspace(build_surrogate(tiny_config(), two, None, lumped_body(two), two.length_m, NullTracker()))
    there, shape = space.tip_at_share(np.full((1, 2), 0.5))[0], CURVES["circle"](40)
    assert 0.0 < space.largest(shape, there) < 0.05 * space.scale
    with pytest.raises(ConfigError, match=r"trajectory circle: .* robot two reaches .* \d\.\d+ mm; .*three directions"):
        space.fitted(shape, there, 0.8, "circle")


def test_a_slope_that_leaves_no_room_is_refused(space: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Workspace, "largest", lambda *_: 1e-4)
    with pytest.raises(ConfigError, match=r"slope_deg=59.*flatter"):
        task_of("force", slope_deg=59.0).training_goals(1, space, np.random.default_rng(0))


def test_joint_limits_without_rest_are_refused(surrogate: Surrogate) -> None:
    with pytest.raises(ArtifactError, match="leave out rest"):
        Workspace(replace(surrogate, joint_low=surrogate.joint_high - 1e-3))
