"""Training in motion: a run goes where its route says, the expert knows the plant, a clone learns from it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build_target
from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.effects.base_tilt import BaseTilt
from softrl.effects.chain import Plant, chain_of
from softrl.effects.delay import Delay
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.effects.strain_softening import StrainSoftening
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.rl import stage
from softrl.rl.actor import Actor
from softrl.rl.agents.agent import Agent, Lesson, Practice
from softrl.rl.evaluate import Controller, expert, lap_all, static_expert
from softrl.rl.inversion import Route
from softrl.rl.moving import MovingBatch, cornered
from softrl.rl.running import Run
from softrl.rl.tasks.task import Goals, Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.surface import Surface
from tests.rl.test_training import CONFIG, MOTION, PLANNING, agent_of, train

CONF = Path(__file__).parents[2] / "conf"
HIDDEN = (Lag(fill_s=0.2, vent_s=0.35), Viscoelasticity(0.3, 1.2, 0.0, 20.0))


@pytest.fixture(scope="module")
def body(robot: Robot) -> PccSimulator:
    """Return the lumped body."""
    node = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    return build_target(node, "simulator", lambda _: robot)


@pytest.fixture(scope="module")
def task() -> Task:
    """Return tracking with short laps."""
    node = yaml.safe_load((CONF / "task" / "track.yaml").read_text())
    return build_target(node | {"alpha": 1.0, "lap_steps": 24, "episode_steps": 12}, "task")


def route_of(robot: Robot, body: PccSimulator, *effects: Effect) -> Route:
    return Route(robot, Plant(body, chain_of(robot, effects)), 0.5, PLANNING.dt_s, 2, lambda position: position)


def batch_of(task: Task, space: Workspace, goals: Goals, size: int, route: Route) -> MovingBatch:
    return MovingBatch(task, space, goals, size, route, MOTION, {})


@pytest.mark.parametrize("effects", [(), HIDDEN, (*HIDDEN, Delay(delay_s=0.06))])
def test_step_by_step_it_goes_where_the_whole_sequence_goes(
    robot: Robot, body: PccSimulator, effects: tuple[Effect, ...]
) -> None:
    route = route_of(robot, body, *effects)
    request = np.random.default_rng(0).uniform(0.0, 20e3, (6, robot.chambers))
    push = np.array([0.2, -0.3, 0.1])
    for force in (None, push):
        run = Run(route, force)
        if force is not None:  # that acts from the first period on in both
            request = request[:3]
        stepped = np.stack([run.advance(row) for row in request])
        np.testing.assert_allclose(stepped, route.predict(request, force), atol=2e-7)


@pytest.mark.parametrize(
    "effects",
    [
        (Payload(0.3), Viscoelasticity(0.8, 1.2, 0.0, 20.0)),
        (Payload(0.3, since_s=1.5, over_s=0.1),),
        (BaseTilt(0.3, 0.0, since_s=1.5, over_s=0.1), StrainSoftening(3.0)),
    ],
    ids=["creeping under it", "put on later", "both halves of a tilt"],
)
def test_what_loads_it_acts_from_its_time_on_and_walls_count_from_where_it_hangs(
    robot: Robot, body: PccSimulator, effects: tuple[Effect, ...]
) -> None:
    leaning = replace(robot, gravity_m_s2=(3.0, 0.0, 9.3))
    route = route_of(leaning, replace(body, robot=leaning), *effects)
    request = np.random.default_rng(0).uniform(0.0, 20e3, (6, robot.chambers))
    run = Run(route)
    np.testing.assert_allclose(np.stack([run.advance(row) for row in request]), route.predict(request), atol=2e-7)


class OneStepAtATime:
    """A body that goes over one step in a call, as the surrogate and the full model do."""

    def __init__(self, body: PccSimulator) -> None:
        self.reset, self.observe, self._step = body.reset, body.observe, body.step

    def step(self, state: Any, pressure: np.ndarray, *rest: Any) -> Any:
        assert pressure.ndim == 1
        return self._step(state, pressure, *rest)


def test_foresight_comes_true_and_leaves_no_trace(robot: Robot, body: PccSimulator) -> None:
    wall = Surface((0.0, 0.0, -1.0), (0.0, 0.0, body.observe(body.reset())[0][2] + 1e-3), 2000.0, 0.3)
    route = route_of(robot, body, *HIDDEN, Delay(delay_s=0.06), wall)
    request = np.random.default_rng(0).uniform(0.0, 20e3, (6, robot.chambers))
    run, undisturbed = Run(route), Run(route)
    for k, row in enumerate(request):
        foreseen = run.foresee(request[k:])
        np.testing.assert_array_equal(run.advance(row), foreseen[0])
        np.testing.assert_array_equal(run.tip, undisturbed.advance(row))
    slow = Run(route_of(robot, OneStepAtATime(body), *HIDDEN, wall))  # type: ignore[arg-type]
    quick = Run(route_of(robot, body, *HIDDEN, wall))
    np.testing.assert_allclose(slow.foresee(request), quick.foresee(request), atol=1e-9)


def test_training_with_a_simulator_that_cannot_hurry_is_refused(
    robot: Robot, body: PccSimulator, space: Workspace, task: Task
) -> None:
    goals = task.evaluation_goals("circle", space)
    with pytest.raises(ConfigError, match="simulator=rom or pcc"):
        batch_of(task, space, goals, 1, route_of(robot, OneStepAtATime(body)))  # type: ignore[arg-type]


def test_polygons_have_their_corners_on_the_curve(space: Workspace, task: Task) -> None:
    goals = task.training_goals(4, space, np.random.default_rng(0))
    cut = cornered(goals, np.random.default_rng(1))
    np.testing.assert_array_equal(cut.position[::2], goals.position[::2])
    same = np.isclose(cut.position[1::2], goals.position[1::2]).all(axis=2)
    assert 0.05 < same.mean() < 0.6 and same[:, 0].all()


def error_mm(controller: Controller, batch: MovingBatch, push: np.ndarray | None = None) -> float:
    return 1e3 * lap_all(controller, batch, push).position_rmse


def test_the_expert_knows_the_plant_and_what_pushes(
    robot: Robot, body: PccSimulator, space: Workspace, task: Task
) -> None:
    route = route_of(robot, body, *HIDDEN)
    goals = task.evaluation_goals("circle", space)

    def noisy(batch: MovingBatch) -> np.ndarray:
        return np.clip(expert(batch) + 0.03 * rng.standard_normal((batch.size, 3)), -1.0, 1.0)

    static = error_mm(static_expert, batch_of(task, space, goals, 1, route))
    known = error_mm(expert, batch_of(task, space, goals, 1, route))
    pushed = error_mm(expert, batch_of(task, space, goals, 1, route), np.array([[0.3, 0.0, 0.0]]))
    rng = np.random.default_rng(0)
    disturbed = error_mm(noisy, batch_of(task, space, goals, 1, route))
    assert known < 0.25 * static
    assert pushed < 0.5 * static
    assert disturbed < static


def test_a_seed_gives_the_same_episodes(robot: Robot, body: PccSimulator, space: Workspace, task: Task) -> None:
    goals = task.training_goals(3, space, np.random.default_rng(0))
    runs = []
    for _ in range(2):
        env = TwinVecEnv(batch_of(task, space, goals, 2, route_of(robot, body, *HIDDEN)), seed=3)
        rows, rng = [env.reset()], np.random.default_rng(4)
        for _ in range(20):  # over the end of an episode
            env.step_async(rng.uniform(-1.0, 1.0, (2, 3)))
            rows.append(env.step_wait()[0])
        runs.append(np.stack(rows))
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize(("effects", "retuned"), [((), False), ((), True), (HIDDEN, False)])
def test_a_policy_tells_whether_the_body_that_it_learnt_on_was_corrected(
    robot: Robot, body: PccSimulator, space: Workspace, task: Task, effects: tuple[Effect, ...], retuned: bool
) -> None:
    chain = replace(chain_of(robot, effects), retuned=retuned)
    goals = task.training_goals(1, space, np.random.default_rng(0))
    batch = batch_of(task, space, goals, 1, route_of(robot, body, *effects))
    actor = Actor({"weight_0": np.zeros((3, batch.observation_size)), "bias_0": np.zeros(3)}, "tanh", "clip")
    made = stage._policy(robot, task, agent_of("bc"), batch, actor, {}, chain)
    assert made.corrected == (retuned or bool(effects))


class Pupil(Agent):
    """An agent that looks where it is to learn, and learns nothing."""

    name = "pupil"

    def train(self, practice: Practice, seed: int) -> Lesson:
        self.place = practice.make(1, seed).batch
        return Lesson(Actor({"weight_0": np.zeros((3, self.place.observation_size)), "bias_0": np.zeros(3)}, "tanh", "clip"), [])


@pytest.mark.parametrize("retuned", [False, True])
def test_a_diagnosis_that_only_retunes_is_learnt_in_motion(
    robot: Robot, body: PccSimulator, surrogate: Surrogate, task: Task, retuned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "_report", lambda *_: {})
    pupil, chain = Pupil(), replace(chain_of(robot, ()), retuned=retuned)
    soft = body.with_parameters(bending_stiffness_scale=0.5)
    made = stage.run(CONFIG, robot, surrogate, task, pupil, soft, chain, tracker=NullTracker())
    assert isinstance(pupil.place, MovingBatch) == retuned == made.corrected == bool(made.memory)


@pytest.mark.slow
def test_a_clone_in_motion_beats_the_static_inverse(robot: Robot, surrogate: Surrogate) -> None:
    policy, metrics = train("bc", robot, surrogate, *HIDDEN)
    assert policy.effects == ("lag", "viscoelasticity") and policy.memory == MOTION.memory_steps
    for curve in ("circle", "figure_eight"):
        clone, static = (metrics[f"heldout/{label}{curve}_position_rmse_mm"] for label in ("", "static_"))
        assert clone < 0.5 * static


@pytest.mark.slow
def test_other_agents_learn_in_motion_too(robot: Robot, surrogate: Surrogate) -> None:
    policy, metrics = train("ppo", robot, surrogate, *HIDDEN)
    assert agent_of("ppo").name == policy.agent_name and 0.0 <= metrics["val/reward"] <= 1.0
