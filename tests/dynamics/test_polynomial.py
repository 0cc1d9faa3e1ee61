"""The closed form finds what is a polynomial, is held outside of its samples, and stays away where data are too few."""

import numpy as np
import pytest
import torch

from softrl.dynamics.dataset import Body, Windows, random_loads, rolled
from softrl.dynamics.evaluate import predictors, rollout_errors
from softrl.dynamics.inverse import InverseNet, fit_inverse
from softrl.dynamics.polynomial import Polynomial, fit_ridge
from softrl.dynamics.training import fit_linear, fit_polynomial
from softrl.dynamics.transformer import ForwardNet
from softrl.robots.robot import Robot

DT_S, RIDGES = 0.01, (1e-8, 1e-6, 1e-4)
LOW, HIGH = np.array([-2e4] * 3 + [-1.0] * 3), np.array([3.5e4] * 3 + [1.0] * 3)


def windows_of(body: Body, robot: Robot, runs: int, seed: int) -> Windows:
    load = random_loads(robot, LOW, HIGH, runs, 150, DT_S, np.random.default_rng(seed))
    return Windows(rolled(body, load, robot.axis, DT_S), 4)


def closed_form(train: Windows, degree: int) -> ForwardNet:
    torch.manual_seed(0)
    net = ForwardNet(11, 6, 4, 8, 2, 1, 8, 2, degree).eval()
    fit_linear(net, train, 1e-5)
    fit_polynomial(net, train, RIDGES, DT_S)
    return net


@pytest.fixture(scope="module")
def train(body: Body, robot: Robot) -> Windows:
    return windows_of(body, robot, 24, 0)


@pytest.fixture(scope="module")
def heldout(body: Body, robot: Robot) -> Windows:
    return windows_of(body, robot, 6, 1)


def test_features_are_the_products_that_they_are_called_and_are_held_beyond_the_range() -> None:
    polynomial = Polynomial(2, 1, 3)
    polynomial.fit_range(torch.tensor([[-1.0, -2.0], [1.0, 2.0]]), torch.tensor([[-3.0], [3.0]]))
    z, u = torch.tensor([0.5, 1.5]), torch.tensor([2.0])
    a, b = z.tolist()
    expected = [a * a, a * b, b * b, a**3, a * a * b, a * b * b, b**3, *(2.0 * m for m in (a, b, a * a, a * b, b * b))]
    assert polynomial(z, u).tolist() == pytest.approx(expected)
    assert polynomial.size == len(expected)
    torch.testing.assert_close(
        polynomial(torch.tensor([9.0, -9.0]), torch.tensor([9.0])), polynomial(torch.tensor([1.0, -2.0]), torch.tensor([3.0]))
    )
    assert Polynomial(2, 3, 1).size == 0


def test_least_squares_finds_the_coefficients_and_gives_none_to_noise(train: Windows) -> None:
    true = torch.randn(5, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def rows_of(index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = torch.sin(index[:, None] * torch.arange(1.0, 6.0)[None])
        return x, x.double() @ true

    torch.testing.assert_close(fit_ridge(rows_of, train, (1e-10, 1.0)), true, rtol=1e-6, atol=1e-6)

    def noise(index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        drawn = torch.randn(len(index), 302, generator=torch.Generator().manual_seed(int(index[0])))
        return drawn[:, :300], drawn[:, 300:]

    assert not fit_ridge(noise, train, (1e-8, 1e-6)).any()


def test_the_closed_form_rolls_out_far_better_than_the_linear_map(body: Body, train: Windows, heldout: Windows) -> None:
    net = closed_form(train, 3)
    known = predictors(net, body, DT_S)
    errors = {name: rollout_errors(known[name], heldout, 100, DT_S) for name in ("arx", "polynomial", "f_s")}
    assert errors["polynomial"]["position_rollout_mm"] < 0.3 * errors["arx"]["position_rollout_mm"], errors
    assert errors["f_s"] == errors["polynomial"]  # the encoder begins at zero
    rows, _ = heldout.take(torch.arange(40))
    torch.testing.assert_close(net(rows)[:, -1], net.last(rows), rtol=1e-4, atol=1e-4)
    linear = closed_form(train, 1)
    torch.testing.assert_close(linear.closed_rate(rows), linear.linear_rate(rows))


def test_few_data_leave_a_map_that_is_no_worse_than_the_linear_one(body: Body, robot: Robot, heldout: Windows) -> None:
    net = closed_form(windows_of(body, robot, 1, 2), 3)
    known = predictors(net, body, DT_S)
    errors = [rollout_errors(known[name], heldout, 50, DT_S)["position_rollout_mm"] for name in ("polynomial", "arx")]
    assert errors[0] < 1.2 * errors[1], errors


def test_the_inverse_in_closed_form_finds_pressures(train: Windows, heldout: Windows) -> None:
    """Pressures balance forces at the coordinates that are wanted next: there a polynomial is all but exact."""
    forward = ForwardNet(11, 6, 4, 8, 2, 1, 8, 2)
    fit_linear(forward, train, 1e-5)
    rows, wanted = heldout.take(torch.arange(len(heldout)))
    left = []
    for degree in (1, 3):
        net = InverseNet(11, 3, 8, DT_S, degree)
        fit_inverse(net, forward, train, 1e-5, RIDGES)
        with torch.no_grad():
            left.append(float((net(rows, wanted) - rows[:, -1, 22:25]).pow(2).mean().sqrt()))
    assert left[1] < 0.2 * left[0], f"linear {left[0]:.3g} Pa, polynomial {left[1]:.3g} Pa"
