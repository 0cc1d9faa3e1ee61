"""The residual is physics: it vanishes on motions of the body and on no others, and its gradient is right."""

import numpy as np
import pytest
import torch

from softrl.dynamics.dataset import Body, Windows, random_loads, rolled, trajectories_from
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.training import fit_linear
from softrl.dynamics.transformer import ForwardNet
from softrl.robots.robot import Robot

DT_S, STATES = 0.01, 11
LOW, HIGH = np.array([-2e4] * 3 + [-1.0] * 3), np.array([3.5e4] * 3 + [1.0] * 3)


@pytest.fixture(scope="module")
def windows(body: Body, robot: Robot) -> Windows:
    load = random_loads(robot, LOW, HIGH, 8, 150, DT_S, np.random.default_rng(0))
    return Windows(rolled(body, load, robot.axis, DT_S), 4)


@pytest.fixture(scope="module")
def physics(body: Body, windows: Windows) -> PhysicsResidual:
    net = ForwardNet(STATES, 6, 4, 16, 4, 1, 16, 2)
    fit_linear(net, windows, 1e-5)
    return PhysicsResidual.fit(body, net, windows, DT_S, 500, 0)


def rms(residual: torch.Tensor) -> float:
    return float(residual.detach().pow(2).mean().sqrt())


def test_it_vanishes_on_the_bodys_motions_and_is_one_for_the_linear_prediction(
    windows: Windows, physics: PhysicsResidual
) -> None:
    rows, rate = windows.take(torch.arange(len(windows)))
    assert rms(physics(rows, rate)) < 0.02  # what single precision leaves
    rows_only = windows.take(torch.randint(len(windows), (500,), generator=torch.Generator().manual_seed(0)))[0]
    net = ForwardNet(STATES, 6, 4, 16, 4, 1, 16, 2)
    fit_linear(net, windows, 1e-5)
    with torch.no_grad():
        assert rms(physics(rows_only, net.linear_rate(rows_only)[:, -1])) == pytest.approx(1.0, abs=0.01)


def test_physics_alone_leads_to_the_true_rates(windows: Windows, physics: PhysicsResidual) -> None:
    """Descent on the residual, without any label, takes the linear prediction to the motion of the body."""
    rows, true = windows.take(torch.arange(100, len(windows), 23))
    net = ForwardNet(STATES, 6, 4, 16, 4, 1, 16, 2)
    fit_linear(net, windows, 1e-5)
    with torch.no_grad():
        start = net.linear_rate(rows)[:, -1]
    correction = torch.zeros_like(start, requires_grad=True)
    optimiser = torch.optim.Adam([correction], lr=0.05)
    for _ in range(300):
        optimiser.zero_grad()
        physics(rows, start + net.fine * correction).pow(2).sum().backward()
        optimiser.step()
    known = [0, 1, 2, 8, 9, 10]  # arc length, curvature and rotation have no force of their own
    before, after = (((rate - true) / net.fine)[:, known] for rate in (start, start + net.fine * correction))
    assert rms(after) < 0.1 * rms(before), f"errors {rms(before):.3g} -> {rms(after):.3g}"


@pytest.mark.parametrize("what", ["rate", "load", "state"])
def test_it_does_not_vanish_on_perturbed_motions(windows: Windows, physics: PhysicsResidual, what: str) -> None:
    rows, rate = windows.take(torch.arange(0, len(windows), 7))
    rows = rows.clone()
    untouched = rms(physics(rows, rate))
    if what == "rate":
        rate = rate * 1.05
    elif what == "load":
        rows[:, -1, 2 * STATES : 2 * STATES + 3] *= 1.05
    else:
        rows[:, -1, 0] += 1e-3
    assert rms(physics(rows, rate)) > 20.0 * untouched


def test_it_falls_with_the_time_step_of_finely_computed_motions(body: Body, robot: Robot) -> None:
    """Motions integrated ten times finer obey the balance of coarse steps to first order in the step."""
    time = 1e-3 * np.arange(401)
    load = np.zeros((1, 401, 6))
    load[0, :, :3] = 1e4 * np.sin(2 * np.pi * time[:, None] * [1.0, 1.5, 0.5]) * np.minimum(time / 0.2, 1.0)[:, None]
    fine = body.roll(load[:, 1:], np.zeros((1, 6)), np.zeros((1, 6)), 1e-3)
    z = np.concatenate([np.zeros((1, 1, 6)), fine], axis=1)
    left = []
    for every in (40, 20, 10):
        part, held = z[:, ::every], load[:, ::every]
        still = np.tile([1.0, 0.0, 0.0, 0.0], (*part.shape[:2], 1))
        coarse = Windows(trajectories_from(part, still, held, body.rest_tip, "+z", 1e-3 * every), 2, from_rest=False)
        rows, rate = coarse.take(torch.arange(len(coarse)))
        unit = PhysicsResidual(
            body, torch.eye(6, dtype=torch.float64), torch.ones(6, dtype=torch.float64), 1e-3 * every
        )
        left.append(rms(unit.force(rows, rate)[:, 3:]))
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert (orders > 0.7).all(), f"residuals {left} N, orders {orders}"


def test_its_gradient_is_that_of_finite_differences(windows: Windows, physics: PhysicsResidual) -> None:
    rows, rate = windows.take(torch.tensor([200]))
    rows, rate = rows.double(), rate.double().requires_grad_()
    (gradient,) = torch.autograd.grad(physics(rows, rate).pow(2).sum(), rate)
    for i in (0, 2, 8, 10):
        h = 1e-6 * max(float(rate[0, i].detach().abs()), 1e-6)
        up, down = (
            physics(rows, rate + s * h * torch.eye(STATES, dtype=torch.float64)[i]).pow(2).sum() for s in (1, -1)
        )
        assert float(gradient[0, i]) == pytest.approx(float((up - down).detach() / (2 * h)), rel=1e-3)
