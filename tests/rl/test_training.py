"""Agents learn, seeds repeat, and a policy runs from its arrays alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build_target
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.tracking import NullTracker
from softrl.effects.chain import chain_of
from softrl.effects.effect import Effect
from softrl.rl.actor import Actor
from softrl.rl.agents.agent import Agent, Best, learn_or_keep
from softrl.rl.inversion import Inversion
from softrl.rl.moving import Motion
from softrl.rl.policy import act, joints
from softrl.rl.stage import Config, run
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"
PLANNING = Inversion(
    dt_s=0.02, memory_steps=3, probe_kpa=0.2, rounds=1, refinements=2, smoothness_mm_per_kpa=0.02, approach_weight=0.1
)  # fmt: skip
MOTION = Motion(
    always=False, courses=6, approach_steps=3, average_window=2, horizon=3, memory_steps=3, noise_mm=0.05,
    rounds=2, bends=(0.1, 0.3), planning=PLANNING,
)  # fmt: skip
CONFIG = Config(training_curves=8, validation_curves=2, episodes=2, motion=MOTION, seed=0)
SMALL = {
    "bc": {"hidden": 32, "envs": 32, "steps": 40, "iterations": 500},
    "sac": {"hidden": 16, "envs": 8, "steps": 400, "learning_starts": 100, "judge_every": 200, "gradient_steps": 1},
    "sac_from_bc": {"hidden": 16, "envs": 8, "steps": 200, "learning_starts": 100, "judge_every": 100, "gradient_steps": 1},
    "ppo": {"hidden": 16, "envs": 8, "steps": 512, "rollout": 32, "batch_size": 128, "judge_every": 256, "epochs": 2},
}
LEARNING = {
    "sac": {"hidden": 64, "envs": 4, "steps": 1200, "gradient_steps": 4, "batch_size": 128, "learning_rate": 3e-3, "gamma": 0.1,
            "judge_every": 400},
    "ppo": {"steps": 4096, "epochs": 10, "judge_every": 1024},
}  # fmt: skip


def agent_of(name: str) -> Agent:
    """Return an agent of conf/, made small."""
    node = yaml.safe_load((CONF / "agent" / f"{name}.yaml").read_text()) | SMALL[name]
    if node.pop("defaults", None):  # sac_from_bc is both in one
        clone, learner = (yaml.safe_load((CONF / "agent" / f"{part}.yaml").read_text()) for part in ("bc", "sac"))
        node = learner | node | {"start_from": clone | SMALL["bc"]}
    return build_target(node, "agent")


def train(name: str, robot: Robot, surrogate: Surrogate, *effects: Effect) -> tuple[Policy, dict[str, float]]:
    """Return a policy for tracking and the stage's metrics."""
    tracker = NullTracker()
    task = yaml.safe_load((CONF / "task" / "track.yaml").read_text()) | {"alpha": 1.0, "lap_steps": 40}
    body = build_target(yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text()), "simulator", lambda _: robot)
    policy = run(
        CONFIG, robot, surrogate, build_target(task, "task"), agent_of(name), body, chain_of(robot, effects), tracker=tracker
    )
    return policy, tracker.metrics


@pytest.fixture(scope="module")
def cloned(robot: Robot, surrogate: Surrogate) -> tuple[Policy, dict[str, float]]:
    """Return a cloned policy and its metrics."""
    return train("bc", robot, surrogate)


def test_cloning_comes_near_the_expert(cloned: tuple[Policy, dict[str, float]]) -> None:
    _, metrics = cloned
    assert metrics["heldout/circle_position_rmse_mm"] < 0.1 * metrics["heldout/rest_circle_position_rmse_mm"]
    assert metrics["heldout/expert_circle_position_rmse_mm"] < 0.01


@pytest.mark.parametrize("name", LEARNING)
def test_other_agents_learn_and_keep_their_best(name: str, robot: Robot, surrogate: Surrogate) -> None:
    """More than standing still is worth, which agents without a gradient are not."""
    task = yaml.safe_load((CONF / "task" / "track.yaml").read_text()) | {"alpha": 1.0, "lap_steps": 40, "position_scale_m": 0.01}
    tracker, agent = NullTracker(), replace(agent_of(name), **LEARNING[name])
    policy = run(CONFIG, robot, surrogate, build_target(task, "task"), agent, None, chain_of(robot, ()), tracker=tracker)
    assert policy.agent_name == name
    for curve in ("circle", "star", "figure_eight"):
        reward, rest = (tracker.metrics[f"heldout/{label}{curve}_reward"] for label in ("", "rest_"))
        assert reward > rest + 0.03, f"{curve}: {reward:.2f}, at rest {rest:.2f}"


def test_a_corrected_clone_is_no_worse_than_the_clone(
    cloned: tuple[Policy, dict[str, float]], robot: Robot, surrogate: Surrogate
) -> None:
    policy, metrics = train("sac_from_bc", robot, surrogate)
    assert policy.agent_name == "sac" and policy.layers - cloned[0].layers in (0, 1)  # 0: no correction was better
    assert metrics["val/reward"] >= cloned[1]["val/reward"]  # the clone is judged first, and the best is kept
    seen = np.zeros((1, policy.observation_size))
    assert np.abs(act(policy)(seen) - act(cloned[0])(seen)).max() <= 0.1 + 1e-3


def test_the_clone_answers_to_a_hidden_force(cloned: tuple[Policy, dict[str, float]]) -> None:
    _, metrics = cloned
    blind = metrics["heldout/open_loop_loaded_circle_position_rmse_mm"]
    assert metrics["heldout/loaded_circle_position_rmse_mm"] < 0.6 * blind
    assert metrics["heldout/expert_loaded_circle_position_rmse_mm"] < 0.3 * blind


def test_a_seed_gives_the_same_policy(
    cloned: tuple[Policy, dict[str, float]], robot: Robot, surrogate: Surrogate
) -> None:
    again, _ = train("bc", robot, surrogate)
    for name, weight in cloned[0].weights.items():
        np.testing.assert_array_equal(weight, again.weights[name])


def test_a_policy_survives_its_folder_and_runs(cloned: tuple[Policy, dict[str, float]], tmp_path: Path) -> None:
    policy = cloned[0]
    policy.save(tmp_path / "policy")
    loaded = Policy.load(tmp_path / "policy")
    seen = np.random.default_rng(0).normal(size=(6, policy.observation_size))
    np.testing.assert_array_equal(act(policy)(seen), act(loaded)(seen))
    command = joints(loaded, act(loaded)(seen))
    slack = 1e-9 * (policy.joint_high - policy.joint_low)
    assert (command >= policy.joint_low - slack).all() and (command <= policy.joint_high + slack).all()


def test_a_foreign_policy_or_observation_is_refused(cloned: tuple[Policy, dict[str, float]]) -> None:
    policy = cloned[0]
    with pytest.raises(ArtifactError, match="robot=other"):
        act(policy, "other")
    with pytest.raises(ArtifactError, match="length 15"):
        act(policy)(np.zeros((1, 9)))


@pytest.mark.parametrize(
    ("name", "changes", "told"),
    [
        ("sac", {"learning_starts": 400}, r"agent.learning_starts=400; expected 0 or more, and less than agent.steps=400"),
        ("sac", {"learning_starts": -5}, "agent.learning_starts=-5"),
        ("ppo", {"batch_size": 1}, "agent.batch_size=1, .* expected 2 steps or more"),
        ("ppo", {"envs": 1, "rollout": 1}, "envs=1 times rollout=1; expected 2 steps or more"),
        ("bc", {"envs": 1, "steps": 1}, "agent.envs=1 times steps=1; expected 2 steps or more"),
    ],
)
def test_agents_that_could_learn_nothing_are_refused(name: str, changes: dict[str, int], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        replace(agent_of(name), **changes)


def test_of_equally_good_actors_the_last_is_kept() -> None:
    best, actors = Best(lambda actor: 1.0), (Actor({}, "tanh", "clip"), Actor({}, "relu", "clip"))
    for step, actor in enumerate(actors):
        best.consider(actor, step)
    assert best.lesson().actor is actors[1]


def test_a_robot_that_is_too_weak_or_hangs_otherwise_is_refused(robot: Robot, surrogate: Surrogate) -> None:
    task = yaml.safe_load((CONF / "task" / "force.yaml").read_text()) | {"alpha": 0.5}
    for changes, error, told in (
        ({"tip_force_max_n": 0.1}, ConfigError, "task.force_max_n=2 is more than the tip is made for"),
        ({"gravity_m_s2": (0.0, 0.0, 1.62)}, ArtifactError, "hangs in gravity .*rerun stage=surrogate"),
    ):
        other = replace(robot, **changes)
        with pytest.raises(error, match=told):
            chain = chain_of(other, ())
            run(CONFIG, other, surrogate, build_target(task, "task"), agent_of("bc"), None, chain, tracker=NullTracker())


def test_training_that_diverges_keeps_the_best_so_far() -> None:
    class Diverging:
        num_timesteps = 7

        def set_logger(self, logger: object) -> None:
            pass

        def learn(self, steps: int, callback: object) -> None:
            raise ValueError("found invalid values: nan")

    judged = iter([0.4, float("nan"), 0.3])
    best = Best(lambda actor: next(judged))
    with pytest.raises(SolverError, match="before any validation"):
        learn_or_keep(Diverging(), 10, None, best)
    first = Actor({}, "tanh", "clip")
    for step, actor in enumerate((first, Actor({}, "relu", "clip"), Actor({}, "relu", "tanh"))):
        best.consider(actor, step)
    learn_or_keep(Diverging(), 10, None, best)
    assert best.lesson().actor is first
