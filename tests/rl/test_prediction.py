"""What follows from what is seen: a linear plant is found exactly, its inverse tracks, and rests at its target only."""

import numpy as np
import pytest

from softrl.artifacts.policy import observation_size
from softrl.core.errors import ConfigError
from softrl.rl.agents.bc import _fold, _linear
from softrl.rl.batch import THETA, TIP
from softrl.rl.moving import differences
from softrl.rl.prediction import Trace, answer, predict

HORIZON, MEMORY, BATCH = 4, 3, 8
TURN = differences(HORIZON, MEMORY)
MIX = np.array([[1.0, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.1, 1.1]])


class Lagging:
    """Tips that lag behind the mean of the last two commands, shifted by what nobody sees."""

    def __init__(self, shift: np.ndarray) -> None:
        self.shift, self.lag = shift, np.zeros_like(shift)
        self.tips, self.commands = [shift] * (MEMORY + 1), [np.zeros_like(shift)] * (MEMORY + 1)

    def advance(self, command: np.ndarray) -> None:
        self.lag = 0.4 * self.lag + 0.6 * 0.5 * (command + self.commands[-1]) @ MIX.T
        self.tips.append(self.lag + self.shift)
        self.commands.append(command)

    def observation(self, targets: np.ndarray) -> np.ndarray:
        """Return what a policy sees (B, k) with the next targets (HORIZON, 3)."""
        size = len(self.shift)
        ahead = np.hstack([targets, np.zeros((HORIZON, 1))]).ravel()
        past = [np.hstack([self.tips[-2 - j], self.commands[-2 - j]]) for j in range(MEMORY)]
        parts = [self.tips[-1], self.commands[-1], np.zeros((size, 1)), np.tile(ahead, (size, 1)), *past]
        return np.hstack(parts)


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Return random commands to plants that are shifted in as many ways, the last of them beyond what is linear."""
    rng = np.random.default_rng(0)
    plant, seen = Lagging(0.2 * rng.standard_normal((BATCH, 3))), []
    for _ in range(60):
        seen.append(plant.observation(rng.standard_normal((HORIZON, 3))))
        plant.advance(0.3 * rng.standard_normal((BATCH, 3)))
    return Trace(np.stack(seen), np.tile(np.arange(60)[:, None], BATCH))


def test_a_linear_plant_is_found_and_led_to_moving_targets(trace: Trace) -> None:
    found = predict([trace], TURN, HORIZON)
    assert found.left.max() < 1e-4
    skip = answer(found, TURN, 0.01)
    target = 0.5 * np.sin(0.1 * np.arange(80)[:, None] + [0.0, 1.0, 2.0])
    plant = Lagging(np.array([[0.3, -0.2, 0.1]]))
    for t in range(70):
        plant.advance(plant.observation(target[t : t + HORIZON]) @ skip)
    error = np.array(plant.tips)[-40:, 0] - target[30:70]
    assert np.abs(error).max() < 0.02 * np.abs(target).max()


def test_it_rests_at_its_target_only(trace: Trace) -> None:
    """Whatever shifts the tip, or however a command stands to it: the last command is kept where tip and target agree."""
    skip = answer(predict([trace], TURN, HORIZON), TURN, 0.1)
    seen = np.random.default_rng(1).standard_normal((20, observation_size(HORIZON, MEMORY)))
    (first, _), *_, (last, bias) = _fold(_linear(skip, 8))
    np.testing.assert_allclose(seen @ (last[:, :3] @ first[:3]).T + bias, seen @ skip, atol=1e-9)
    tips = [TIP.start, *(7 + 4 * i for i in range(HORIZON)), *(observation_size(HORIZON) + 6 * j for j in range(MEMORY))]
    commands = [THETA.start, *(observation_size(HORIZON) + 6 * j + 3 for j in range(MEMORY))]
    for k in range(3):
        assert np.abs(skip[[at + k for at in tips]].sum(axis=0)).max() < 1e-9, "a shift of tips and targets alike"
        np.testing.assert_allclose(skip[[at + k for at in commands]].sum(axis=0), np.eye(3)[k], atol=1e-9)


def test_no_window_reaches_over_the_end_of_an_episode(trace: Trace) -> None:
    rng, cut = np.random.default_rng(2), trace.elapsed % 20
    broken = trace.seen.copy()
    broken[20:40] += rng.standard_normal((1, BATCH, 1))  # as if another robot, elsewhere, had begun
    found = predict([Trace(broken, cut)], TURN, HORIZON)
    assert found.left.max() < 1e-4


def test_a_few_rows_at_the_limits_count_little(trace: Trace) -> None:
    wild = trace.seen.copy()
    wild[::15, :, TIP] += 0.5
    clean, found = (predict([Trace(seen, trace.elapsed)], TURN, HORIZON).command for seen in (trace.seen, wild))
    assert np.abs(found - clean).max() < 0.05 * np.abs(clean).max()


@pytest.mark.parametrize("steps", [2, HORIZON + MEMORY])
def test_data_without_a_past_and_a_future_is_refused(trace: Trace, steps: int) -> None:
    short = Trace(trace.seen[:steps], trace.elapsed[:steps])
    with pytest.raises(ConfigError, match=f"expected agent.steps={steps} and task.episode_steps above {HORIZON + MEMORY}"):
        predict([short], TURN, HORIZON)
    in_pieces = Trace(trace.seen, trace.elapsed % (HORIZON + MEMORY))
    with pytest.raises(ConfigError, match="in one episode"):
        predict([in_pieces], TURN, HORIZON)
    for whole in (HORIZON + MEMORY + 1,):
        predict([Trace(trace.seen, trace.elapsed % whole)], TURN, HORIZON)
