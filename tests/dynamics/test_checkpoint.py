"""A training that was broken off ends where the unbroken one ends."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from softrl.core.errors import SolverError
from softrl.core.resume import Kept
from softrl.core.tracking import NullTracker
from softrl.dynamics import training
from softrl.dynamics.checkpoint import Checkpoint
from softrl.dynamics.dataset import Body
from softrl.dynamics.sets import generate
from softrl.dynamics.stage import _training_mark, learn_forward, learn_inverse, run
from softrl.dynamics.transformer import GruNet, weights_of
from softrl.robots.robot import Robot
from tests.dynamics.test_stage import HIGH, LOW, config
from tests.pod.conftest import fitted

SETTINGS = config(onestep_updates=24, rollout_updates=8, inverse_updates=30, checkpoint_updates=10)


def same(first: torch.nn.Module, second: torch.nn.Module) -> None:
    for name, weight in weights_of(first).items():  # type: ignore[arg-type]
        np.testing.assert_array_equal(weight, weights_of(second)[name], err_msg=name)  # type: ignore[arg-type]


def die_in_update(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Let every training stop in an update, after what it changes is half changed."""
    step, calls = torch.optim.AdamW.step, []

    def killed(self: torch.optim.AdamW, *arguments: object) -> object:
        calls.append(1)
        made = step(self, *arguments)
        if len(calls) == number:
            raise KeyboardInterrupt
        return made

    monkeypatch.setattr(torch.optim.AdamW, "step", killed)


@pytest.mark.parametrize(("number", "resumed"), [(16, 10), (29, 20), (7, 0)])
def test_a_broken_off_training_ends_as_the_unbroken_one(
    body: Body, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, resumed: int
) -> None:
    sets = generate(SETTINGS, robot, body, LOW, HIGH)
    whole, history = learn_forward(SETTINGS, sets, body)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        die_in_update(patch, number)
        learn_forward(SETTINGS, sets, body, checkpoint=Checkpoint(Kept("d", "x", tmp_path), "f_S", 10))
    torch.rand(7)  # what else was drawn meanwhile does not matter
    checkpoint = Checkpoint(Kept("d", "x", tmp_path), "f_S", 10)
    again, other = learn_forward(SETTINGS, sets, body, checkpoint=checkpoint)
    assert checkpoint.resumed == resumed
    same(whole, again)
    for name in ("data", "physics", "validation", "validation_update"):
        np.testing.assert_array_equal(getattr(history, name), getattr(other, name))


def test_inverse_and_recurrent_network_go_on_too(
    body: Body, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets = generate(SETTINGS, robot, body, LOW, HIGH)
    kept = Kept("d", "x", tmp_path)
    gru = learn_forward(SETTINGS, sets, body, GruNet)[0]
    inverse, losses = learn_inverse(SETTINGS, gru, sets.train)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        die_in_update(patch, 16)
        learn_forward(SETTINGS, sets, body, GruNet, Checkpoint(kept, "gru", 10))
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        die_in_update(patch, 25)
        learn_inverse(SETTINGS, gru, sets.train, Checkpoint(kept, "inverse", 10))
    checkpoints = Checkpoint(kept, "gru", 10), Checkpoint(kept, "inverse", 10)
    same(gru, learn_forward(SETTINGS, sets, body, GruNet, checkpoints[0])[0])
    again, others = learn_inverse(SETTINGS, gru, sets.train, checkpoints[1])
    same(inverse, again)
    np.testing.assert_array_equal(losses, others)
    assert [checkpoint.resumed for checkpoint in checkpoints] == [10, 20]


def test_a_rate_that_blows_the_weights_up_is_told(body: Body, robot: Robot, tmp_path: Path) -> None:
    sets, kept = generate(SETTINGS, robot, body, LOW, HIGH), Kept("d", "x", tmp_path)
    with pytest.raises(SolverError, match=r"diverged in update .*stage\.learning_rate"):
        learn_forward(replace(SETTINGS, learning_rate=1e3), sets, body, checkpoint=Checkpoint(kept, "f_S", 1))
    assert all(np.isfinite(array).all() for name, array in kept.load("f_S").items() if name.startswith("net"))


@pytest.mark.slow
def test_the_stage_goes_on_and_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot, snapshots, model = fitted(3)
    small = config(onestep_updates=20, gru_update_share=0.0)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        die_in_update(patch, 15)
        run(small, robot, model, snapshots, tracker=NullTracker())
    assert (tmp_path / ".softrl").is_dir()
    broken, whole = NullTracker(), NullTracker()
    made = run(small, robot, model, snapshots, tracker=broken)
    assert broken.metrics.pop("updates_resumed") == 10
    assert list(tmp_path.iterdir()) == []
    again = run(small, robot, model, snapshots, tracker=whole)
    assert whole.metrics.pop("updates_resumed") == 0
    assert broken.metrics == whole.metrics
    for first, second in zip(made, again, strict=True):
        for name, weight in first.weights.items():
            np.testing.assert_array_equal(weight, second.weights[name], err_msg=name)


def test_what_changes_the_weights_is_another_training() -> None:
    motion = Kept("dynamics", "x")
    marks = [_training_mark(c, motion) for c in (SETTINGS, replace(SETTINGS, processes=7, rollout_s=0.3))]
    assert marks[0] == marks[1]
    for key, value in (("learning_rate", 1e-3), ("physics_weight", 0.5), ("width", 32), ("seed", 1)):
        assert _training_mark(replace(SETTINGS, **{key: value}), motion) != marks[0], key
    assert _training_mark(SETTINGS, Kept("dynamics", "y")) != marks[0]


def test_a_training_that_diverges_is_told_and_its_last_good_state_stays(
    body: Body, robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets = generate(SETTINGS, robot, body, LOW, HIGH)
    kept, calls, loss = Kept("d", "x", tmp_path), [], training._onestep_loss

    def spoilt(*arguments: object) -> tuple[torch.Tensor, torch.Tensor]:
        calls.append(1)
        data, residual = loss(*arguments)  # type: ignore[arg-type]
        return (data * torch.nan if len(calls) == 13 else data), residual

    with monkeypatch.context() as patch, pytest.raises(SolverError, match=r"stage\.learning_rate"):
        patch.setattr(training, "_onestep_loss", spoilt)
        learn_forward(SETTINGS, sets, body, checkpoint=Checkpoint(kept, "f_S", 10))
    assert int(kept.load("f_S")["done"]) == 10
    assert all(np.isfinite(array).all() for name, array in kept.load("f_S").items() if name.startswith("net"))
