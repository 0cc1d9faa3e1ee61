"""Chunks on disk hold the same windows as memory would, whoever makes them and after however many kills."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from softrl.core.parallel import LOCAL
from softrl.core.resume import Kept
from softrl.core.scaling import Scaler
from softrl.dynamics import generate
from softrl.dynamics.dataset import Windows
from softrl.dynamics.generate import Recipe, generate_chunks, make_chunk
from softrl.dynamics.training import _scaler
from softrl.robots.robot import Robot

RUNS, PER_CHUNK, STEPS, WINDOW = 7, 3, 21, 4


@pytest.fixture
def recipe(robot: Robot, body: object) -> Recipe:
    low, high = np.r_[np.full(3, -2e4), np.full(3, -1.0)], np.r_[np.full(3, 3e4), np.full(3, 1.0)]
    return Recipe(robot, body, low, high, STEPS, 0.01, WINDOW, np.diag([1e-5] * 3 + [0.03] * 3))  # type: ignore[arg-type]


def made(recipe: Recipe, folder: Path, processes: int = 1) -> generate.Generated:
    return generate_chunks(recipe, RUNS, PER_CHUNK, np.random.SeedSequence(5), LOCAL, processes, Kept("m", "x", folder))


def test_stored_windows_are_those_of_memory(recipe: Recipe, tmp_path: Path) -> None:
    found = made(recipe, tmp_path)
    of_chunks = zip((3, 3, 1), np.random.SeedSequence(5).spawn(3), (0, 3, 6), strict=True)
    parts = [make_chunk(recipe, n, s, first) for n, s, first in of_chunks]
    rows = torch.tensor(np.concatenate([part.rows for part in parts]))
    assert torch.equal(found.windows.rows, rows) and len(found.windows) == RUNS * (STEPS - 1)
    index = torch.tensor([0, 19, 20, 77, len(found.windows) - 1])
    window, rate = found.windows.take(index)
    assert window.shape == (5, WINDOW, rows.shape[2]) and rate.shape == (5, 11)
    assert found.within_reach == sum(part.within_reach for part in parts) > 0
    assert found.resumed == 0
    whole = Scaler.fit(rows[:, WINDOW - 1 :].numpy().astype(float))
    piecewise = _scaler(found.windows, runs=2)
    np.testing.assert_allclose(piecewise.mean, whole.mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(piecewise.spread, whole.spread, rtol=1e-9)


@pytest.mark.parametrize("per_chunk", [1, 2, 3, 8])
def test_kinds_of_runs_do_not_depend_on_the_chunks(recipe: Recipe, tmp_path: Path, per_chunk: int) -> None:
    """The size of a chunk is a matter of memory: two of four runs feel a force, and steps and multisines take turns."""
    long = replace(recipe, steps=200)
    found = generate_chunks(long, 8, per_chunk, np.random.SeedSequence(5), LOCAL, 1, Kept("m", "x", tmp_path))
    load = found.windows.rows[:, WINDOW:, -6:].numpy()
    assert load[:, :, 3:].any(axis=(1, 2)).tolist() == [True, True, False, False] * 2
    held = (np.abs(np.diff(load[:, :, 0], axis=1)) < 1.0).mean(axis=1)
    assert (held > 0.5).tolist() == [True, False] * 4, held


def test_processes_and_kills_change_nothing(
    recipe: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = made(recipe, tmp_path / "whole", processes=2)
    calls = []

    def make_two(*task: object) -> generate.Chunk:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return make_chunk(*task)  # type: ignore[arg-type]

    monkeypatch.setattr(generate, "make_chunk", make_two)
    with pytest.raises(KeyboardInterrupt):
        made(recipe, tmp_path / "killed")
    again = made(recipe, tmp_path / "killed")
    assert again.resumed == 2 and len(calls) == 4
    assert torch.equal(again.windows.rows, whole.windows.rows)
    assert torch.equal(again.windows.next_rate, whole.windows.next_rate)
    assert isinstance(again.windows, Windows)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_runs(recipe: Recipe, tmp_path: Path) -> None:
    long, peaks = replace(recipe, steps=600), []  # beside chunks of some size the list of them is nothing
    for runs in (8, 64):
        tracemalloc.start()
        generate_chunks(long, runs, 4, np.random.SeedSequence(1), LOCAL, 1, Kept("m", str(runs), tmp_path))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.3 * peaks[0]
