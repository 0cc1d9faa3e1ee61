"""What measured pressures are taken for once the valve before them is understood."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.core.span import held
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging import parts
from softrl.effects.chain import EffectChain
from softrl.effects.driving import drive_on_grid, evenly
from softrl.effects.tube_line import TubeLine
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.diagnosis.series import coloured

FINE_S = 0.002
LINE = TubeLine(period_s=0.3, damping_ratio=0.8)  # begins slowly, so that two samples do not tell how it went between


def test_a_bias_is_taken_out_where_it_is_one_for_sure_only() -> None:
    rng = np.random.default_rng(0)
    white = 60.0 * rng.standard_normal((1500, 3)) + [300.0, -40.0, 0.0]
    np.testing.assert_allclose(parts.bias(white), [300.0, -40.0, 0.0], atol=6.0)
    slow = np.stack([800.0 * coloured(rng, 1500, 0.99) * np.sqrt(1.0 - 0.99**2) for _ in range(3)], axis=1)
    assert np.abs(slow.mean(axis=0)).max() > 50.0
    np.testing.assert_allclose(parts.bias(slow), 0.0, atol=30.0)


def steps(robot: Robot, period_s: float) -> tuple[Recording, np.ndarray, np.ndarray]:
    """Return a run of a slow valve, sampled every ``period_s``, with what it supplied, on a fine grid (steps,)."""
    rng = np.random.default_rng(2)
    rows = 2e4 * rng.uniform(size=(round(20.0 / period_s) + 1, robot.chambers)).round(1)
    time, stamps = FINE_S * np.arange(round(20.0 / FINE_S) + 1), period_s * np.arange(len(rows))
    fine = rows[np.minimum(np.searchsorted(stamps, time - 1e-9), len(rows) - 1)]
    chain = EffectChain(robot, (LINE,))
    true = chain.supplied(held(fine), FINE_S).end
    run = Recording("run", "day", stamps, rows, pressure_meas=evenly(stamps, time, true))
    return run, time, true


def understood(monkeypatch: pytest.MonkeyPatch, robot: Robot, time: np.ndarray, true: np.ndarray) -> Any:
    """Return a valve that is known, which gives ``true`` (steps, chambers) at ``time`` (steps,)."""

    def supplied(runs: list[Recording], _: Any, shown: bool = True) -> list[Recording]:
        return [Recording(r.name, r.session, r.time, r.pressure_cmd, pressure_meas=evenly(r.time, time, true)) for r in runs]

    monkeypatch.setattr(parts, "supplied", supplied)
    space = SimpleNamespace(effects=lambda *_: (LINE,), late=lambda _: 0.0)
    problem = SimpleNamespace(robot=robot, space=lambda _: space, on=lambda _: problem, late_in=lambda _, late_s: late_s)
    final = SimpleNamespace(hypothesis=None, fit=SimpleNamespace(point=None))
    return SimpleNamespace(final=final, part=SimpleNamespace(problem=problem))


def test_a_body_sees_what_the_valve_does_between_samples(monkeypatch: pytest.MonkeyPatch, tripod: Robot) -> None:
    run, time, true = steps(tripod, 0.1)
    ((mended, known),) = parts._understood([run], understood(monkeypatch, tripod, time, true), 1.0)
    grid, plain, _ = drive_on_grid(run, 0.01, "measured", 0.0)
    _, seen, _ = drive_on_grid(mended, 0.01, "measured", 0.0, 0.0, known)
    wanted = evenly(grid, time, true)
    missed = [float(np.sqrt(np.mean((drive.end - wanted)[2:] ** 2))) for drive in (plain, seen)]
    assert missed[0] > 500.0 and missed[1] < 0.1 * missed[0], missed


def test_the_body_is_driven_the_same_by_an_understood_valve_and_by_its_pressures(
    monkeypatch: pytest.MonkeyPatch, tripod: Robot
) -> None:
    run, time, true = steps(tripod, 0.1)
    ((mended, known),) = parts._understood([run], understood(monkeypatch, tripod, time, true), 1.0)
    grid, seen, _ = drive_on_grid(mended, 0.01, "measured", 0.0, 0.03, known)
    _, command, _ = drive_on_grid(run, 0.01, "command", 0.0, 0.03)
    made = EffectChain(tripod, (LINE,)).supplied(command, 0.01)
    for ours, wanted in zip(seen, made, strict=True):
        np.testing.assert_allclose(ours, wanted, atol=1e-3 * np.ptp(true))


def test_an_understood_valve_is_as_late_as_each_log_is_slow(monkeypatch: pytest.MonkeyPatch, tripod: Robot) -> None:
    """A log is late by a share of its rows: of one of twice the interval the valve's commands act twice as late, too."""
    (often, time, true), (seldom, *_) = steps(tripod, 0.1), steps(tripod, 0.2)
    valve = understood(monkeypatch, tripod, time, true)
    monkeypatch.setattr(Problem, "space", lambda *_: SimpleNamespace(effects=lambda *_: (LINE,), late=lambda _: 0.04))
    runs = (often, replace(seldom, name="seldom"))
    valve.part.problem = Problem(
        tripod, SimpleNamespace(), runs, SimpleNamespace(), "pressure", "command", False, False, interval_s=0.1
    )  # fmt: skip
    assert [known.late_s for _, known in parts._understood(runs, valve, 1.0)] == pytest.approx([0.04, 0.08])


@pytest.mark.parametrize(("unexplained", "kept"), [(0.0, 0.0), (3e3, 1.0)])
def test_a_gauge_s_noise_does_not_drive_the_body_but_what_the_valve_leaves_does(
    monkeypatch: pytest.MonkeyPatch, tripod: Robot, unexplained: float, kept: float
) -> None:
    run, time, true = steps(tripod, 0.05)
    rng = np.random.default_rng(4)
    noise = 200.0 * rng.standard_normal(run.pressure_cmd.shape)
    left = unexplained * np.sin(2.0 * run.time)[:, None] * np.ones(3)
    clean = evenly(run.time, time, true)
    seen = Recording("run", "day", run.time, run.pressure_cmd, pressure_meas=clean + left + noise)
    ((mended, known),) = parts._understood([seen], understood(monkeypatch, tripod, time, true), 200.0 * np.sqrt(3.0))
    for missed in (np.asarray(mended.pressure_meas) - clean - left, known.apart - left):
        assert np.sqrt(np.mean(missed**2)) < 40.0 + 180.0 * kept
