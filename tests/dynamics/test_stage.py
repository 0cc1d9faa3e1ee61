"""Learning on a body known in closed form: better than linear, physics counts, scalers and seeds behave."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

from softrl.artifacts.dynamics import ForwardDynamics, InverseDynamics
from softrl.core import fingerprint
from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.dynamics.body import ReducedBody
from softrl.dynamics.dataset import Body, Windows
from softrl.dynamics.evaluate import onestep_errors, predictors, rollout_errors
from softrl.dynamics.inverse import inverse_errors, inverse_net
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.sets import Sets, generate
from softrl.dynamics.stage import Config, _mark, learn_forward, learn_inverse, report, run
from softrl.dynamics.transformer import ForwardNet, forward_net, weights_of
from softrl.robots.robot import Robot
from tests.pod.conftest import fitted

CONF = Path(__file__).resolve().parents[2] / "conf" / "stage"
LOW, HIGH = np.array([-2e4] * 3 + [-1.0] * 3), np.array([3.5e4] * 3 + [1.0] * 3)


def config(**changes: float) -> Config:
    parts = (
        OmegaConf.load(CONF / "dynamics.yaml"),
        OmegaConf.load(CONF.parent / "profile/tiny/dynamics.yaml"),
        changes,
    )
    whole = OmegaConf.merge({"seed": 0, "lambda": 0.01}, {"stage": OmegaConf.merge(*parts)})
    return Config(**OmegaConf.to_container(whole.stage, resolve=True))  # type: ignore[arg-type]


FAST = {"training_runs": 24, "run_s": 1.5, "batch": 64, "onestep_updates": 300, "rollout_updates": 0, "width": 32,
        "feedforward": 64, "inverse_updates": 200, "inverse_hidden": 32, "inverse_batch": 128, "learning_rate":
        3e-3}  # fmt: skip


@pytest.fixture(scope="module")
def sets(body: Body, robot: Robot) -> Sets:
    return generate(config(**FAST), robot, body, LOW, HIGH)


@pytest.fixture(scope="module")
def trained(body: Body, sets: Sets) -> ForwardNet:
    torch.set_num_threads(1)
    return learn_forward(config(**FAST), sets, body)[0]


def test_network_beats_the_linear_map_and_persistence_on_unseen_runs(
    body: Body, sets: Sets, trained: ForwardNet
) -> None:
    windows = Windows(sets.heldout, trained.window)
    known = predictors(trained, body, 0.01)
    onestep = {name: onestep_errors(p, windows, 0.01)["position_onestep_mm"] for name, p in known.items()}
    assert onestep["f_s"] < 0.8 * onestep["arx"] < 0.8 * onestep["rate_stays"] < onestep["state_stays"], onestep
    assert onestep["rom"] < 1e-4, "the body itself must be exact on its own motions"
    assert rollout_errors(known["rom"], windows, 30, 0.01)["position_rollout_mm"] < 1e-3


def test_physics_weight_changes_the_answer(body: Body, sets: Sets) -> None:
    rows, _ = Windows(sets.heldout, config().window).take(torch.arange(50))
    nets = [learn_forward(config(physics_weight=weight), sets, body)[0] for weight in (0.0, 0.1, 1.0)]
    with torch.no_grad():
        answers = [net(rows)[:, -1] for net in nets]
    assert not torch.equal(answers[0], answers[1])
    assert not torch.equal(answers[1], answers[2])


def test_scalers_and_training_see_training_runs_only(body: Body, sets: Sets) -> None:
    spoilt = (
        replace(sets.heldout, state=sets.heldout.state + 1.0),
        replace(sets.validation, rate=10.0 * sets.validation.rate),
    )
    first, _ = learn_forward(config(), sets, body)
    second, history = learn_forward(config(), Sets(sets.train, spoilt[1], spoilt[0]), body)
    for name, weight in weights_of(first).items():
        np.testing.assert_array_equal(weight, weights_of(second)[name], err_msg=name)
    assert history.validation[-1] > 1.0


def test_outside_means_larger_and_faster_than_any_training_run(body: Body, robot: Robot) -> None:
    c = config(training_runs=12, outside_runs=12, run_s=2.0)
    made = generate(c, robot, body, LOW, HIGH)
    assert made.outside is not None
    inside, outside = made.train.load, made.outside.load
    assert (inside >= LOW - 1e-9).all() and (inside <= HIGH + 1e-9).all()
    assert ((outside < LOW - 1e-9) | (outside > HIGH + 1e-9)).any(axis=(0, 1)).all(), "every channel leaves the range"
    assert (np.abs(outside) <= c.outside_load_factor * np.maximum(-LOW, HIGH) + 1e-9).all()
    speeds = [np.abs(np.diff(load[..., :3], axis=1)).max() / c.dt_s for load in (inside, outside)]
    assert speeds[0] <= 1.0001 * robot.slew_pa_per_s < speeds[1] <= 1.0001 * 2.0 * robot.slew_pa_per_s
    fewer = generate(config(training_runs=4, run_s=2.0, outside_runs=12), robot, body, LOW, HIGH)
    np.testing.assert_array_equal(fewer.train.load, inside[:4], err_msg="a smaller share is the beginning")
    np.testing.assert_array_equal(fewer.outside.load, outside)  # type: ignore[union-attr]
    assert generate(config(training_runs=1, outside_runs=0), robot, body, LOW, HIGH).outside is None


def test_runs_of_the_three_sets_differ(sets: Sets) -> None:
    for first, second in ((sets.train, sets.heldout), (sets.train, sets.validation), (sets.validation, sets.heldout)):
        for load in second.load:
            assert np.abs(first.load - load).max(axis=(1, 2)).min() > 1.0


def test_tiny_training_with_one_seed_is_identical_and_survives_the_disk(
    body: Body, robot: Robot, sets: Sets, tmp_path: Path
) -> None:
    c = config(rollout_updates=3)
    nets = [learn_forward(c, sets, body)[0] for _ in range(2)]
    inverses = [learn_inverse(c, net, sets.train)[0] for net in nets]
    for pair in (nets, inverses):
        for name, weight in weights_of(pair[0]).items():
            np.testing.assert_array_equal(weight, weights_of(pair[1])[name], err_msg=name)
    forward = ForwardDynamics(
        weights_of(nets[0]), c.window, c.width, c.heads, c.layers, c.feedforward, c.linear_rows, c.dt_s,
        c.physics_weight, LOW, HIGH, body.rest_tip, np.zeros(3), robot.axis, 3, robot.name, c.polynomial_degree,
    )  # fmt: skip
    inverse = InverseDynamics(
        weights_of(inverses[0]), c.inverse_hidden, c.dt_s, c.cycle_weight, 3, robot.name, c.polynomial_degree
    )
    forward.save(tmp_path / "forward")
    inverse.save(tmp_path / "inverse")
    rows, rate = Windows(sets.heldout, c.window).take(torch.arange(20))
    with torch.no_grad():
        torch.testing.assert_close(forward_net(ForwardDynamics.load(tmp_path / "forward"))(rows), nets[0](rows))
        again = inverse_net(InverseDynamics.load(tmp_path / "inverse"))
        torch.testing.assert_close(again(rows, rate), inverses[0](rows, rate))


def test_inverse_finds_pressures_and_the_cycle_weight_counts(sets: Sets, trained: ForwardNet) -> None:
    windows = Windows(sets.heldout, trained.window)
    with_cycle, _ = learn_inverse(config(**FAST), trained, sets.train)
    without, losses = learn_inverse(config(**FAST | {"cycle_weight": 0.0}), trained, sets.train)
    errors = inverse_errors(with_cycle, trained, windows)
    assert errors["inverse_pressure_kpa"] < errors["linear_inverse_pressure_kpa"]
    assert errors["inverse_pressure_kpa"] < 0.02 * errors["mean_inverse_pressure_kpa"], errors
    assert not losses[:, 1].any()
    rows, rate = windows.take(torch.arange(50))
    with torch.no_grad():
        assert not torch.equal(with_cycle(rows, rate), without(rows, rate))


def test_inverse_does_not_read_the_pressures_that_it_answers(sets: Sets, trained: ForwardNet) -> None:
    net, _ = learn_inverse(config(), trained, sets.train)
    rows, rate = Windows(sets.heldout, trained.window).take(torch.arange(20))
    changed = rows.clone()
    changed[:, -1, 22:25] += 5e3
    with torch.no_grad():
        torch.testing.assert_close(net(rows, rate), net(changed, rate))


def test_report_names_errors_beside_baselines(body: Body, sets: Sets, trained: ForwardNet) -> None:
    tracker = NullTracker()
    inverse, _ = learn_inverse(config(), trained, sets.train)
    report(config(), trained, inverse, body, sets, sets.validation, tracker)
    for name in ("position_onestep_mm", "position_rollout_mm", "velocity_onestep_mm_s", "velocity_rollout_mm_s"):
        for baseline in ("", "arx_", "polynomial_", "rate_stays_", "state_stays_"):
            assert np.isfinite(tracker.metrics[f"heldout/{baseline}{name}"])
            assert np.isfinite(tracker.metrics[f"outside/{baseline}{name}"])
        assert f"outside/rom_{name}" not in tracker.metrics
        assert np.isfinite(tracker.metrics[f"full_model/rom_{name}"])
        assert f"heldout/rom_{name}" not in tracker.metrics
    assert np.isfinite(tracker.metrics["heldout/inverse_pressure_kpa"])
    least, own = (tracker.metrics[f"heldout/physics_residual_{what}share"] for what in ("of_motions_", ""))
    assert 0.0 <= least < 0.1 * own < 0.1, "forces balance better than by the linear map, and along motions best"


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("physics_weight", -1.0, "lambda=-1"),
        ("width", 30, "stage.heads"),
        ("batch", 0, "stage.batch=0 must be positive"),
        ("window", 1, "stage.linear_rows"),
        ("run_s", 0.2, "stage.run_s"),
    ],
)
def test_bad_values_name_the_key(key: str, value: float, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        config(**{key: value})


def test_stage_runs_on_a_fitted_reduced_model_whose_motions_leave_no_residual() -> None:
    """The whole stage on the torch twin; rotation and volumes included."""
    robot, snapshots, model = fitted(3)
    tracker, plain = NullTracker(), config(weight=False)  # as the synthetic trajectories are
    forward = run(plain, robot, model, snapshots, tracker=tracker).forward
    assert tracker.metrics["full_model/rom_position_onestep_mm"] < tracker.metrics["full_model/arx_position_onestep_mm"]
    body = ReducedBody(model, np.zeros(3))
    sets = generate(config(), robot, body, forward.load_low, forward.load_high)
    windows = Windows(sets.heldout, config().window)
    physics = PhysicsResidual.fit(body, forward_net(forward), Windows(sets.train, config().window), 0.01, 200, 0)
    rows, rate = windows.take(torch.arange(len(windows)))
    with torch.no_grad():
        true, wrong = (float(physics(rows, r).pow(2).mean().sqrt()) for r in (rate, 1.05 * rate))
    assert true < 0.1 * wrong, f"residual of motions {true:.3g}, of rates 5 % off {wrong:.3g}"


@pytest.mark.parametrize("module", ["sets", "generate", "body"])
def test_kept_chunks_are_left_where_the_code_that_makes_them_changes(monkeypatch: pytest.MonkeyPatch, module: str) -> None:
    robot, _, model = fitted(3)
    before, read = _mark(config(), robot, model), fingerprint._source
    assert _mark(config(), robot, model) == before
    changed = f"softrl.dynamics.{module}"
    monkeypatch.setattr(fingerprint, "_source", lambda name: read(name) + "#" * (name == changed))
    assert _mark(config(), robot, model) != before


@pytest.mark.slow
def test_training_from_chunks_on_disk_is_the_same_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot, snapshots, model = fitted(3)
    plain, chunked = NullTracker(), NullTracker()
    run(config(), robot, model, snapshots, tracker=plain)
    learnt = run(config(runs_per_chunk=2), robot, model, snapshots, tracker=chunked).forward
    assert set(chunked.metrics) - set(plain.metrics) == {"chunks_resumed", "samples_within_reach_pct"}
    assert chunked.metrics["training_samples"] == plain.metrics["training_samples"] == 600
    assert chunked.metrics["heldout/position_onestep_mm"] < chunked.metrics["heldout/state_stays_position_onestep_mm"]
    assert 50.0 < chunked.metrics["samples_within_reach_pct"] <= 100.0
    full, reduced = chunked.metrics["full_order_samples"], chunked.metrics["reduced_model_samples"]
    assert chunked.metrics["full_order_share_pct"] == pytest.approx(100.0 * full / (full + reduced))
    assert learnt.training_samples == 600 and learnt.full_order_share == full / (full + reduced)
    assert list(tmp_path.iterdir()) == []
