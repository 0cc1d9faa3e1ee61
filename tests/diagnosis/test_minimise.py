"""The search finds minima, respects bounds, survives failures and is thrifty."""

import numpy as np
import pytest

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.minimise import jacobian_at, least_squares, moved_on, refine

FAR = np.array([10.0, 10.0])


def rosenbrock(u: np.ndarray) -> np.ndarray:
    return np.array([10.0 * (u[1] - u[0] ** 2), 1.0 - u[0]])


def test_finds_the_minimum_of_a_curved_valley() -> None:
    fit = least_squares(rosenbrock, np.array([-1.2, 1.0]), -FAR, FAR, 60, step=1e-5, tolerance=0.0)
    np.testing.assert_allclose(fit.point, [1.0, 1.0], atol=1e-3)


def test_linear_problem_takes_one_step() -> None:
    rng = np.random.default_rng(0)
    matrix, target = rng.standard_normal((30, 4)), rng.standard_normal(30)
    fit = least_squares(lambda u: matrix @ u - target, np.zeros(4), -10 * np.ones(4), 10 * np.ones(4), 6)
    np.testing.assert_allclose(fit.point, np.linalg.lstsq(matrix, target, rcond=None)[0], atol=1e-3)
    np.testing.assert_allclose(fit.jacobian, matrix, atol=1e-8)
    assert fit.evaluations < 25


def test_bound_holds_and_the_rest_is_optimal_there() -> None:
    fit = least_squares(rosenbrock, np.array([0.0, 0.0]), -FAR, np.array([0.5, 10.0]), 60, step=1e-5, tolerance=0.0)
    np.testing.assert_allclose(fit.point, [0.5, 0.25], atol=1e-3)


def test_failed_evaluations_are_walked_around() -> None:
    def residual(u: np.ndarray) -> np.ndarray:
        if u[0] > 1.5:
            raise SolverError("diverged")
        return np.array([u[0] ** 3 - 1.0])

    fit = least_squares(residual, np.array([0.2]), np.array([-5.0]), np.array([5.0]), 30, step=1e-4)
    assert fit.point[0] == pytest.approx(1.0, abs=1e-3)


def test_jacobian_turns_backward_at_the_upper_bound() -> None:
    columns = jacobian_at(rosenbrock, np.array([1.0, 1.0]), rosenbrock(np.ones(2)), -FAR, np.ones(2), 1e-6)
    np.testing.assert_allclose(columns, [[-20.0, 10.0], [-1.0, 0.0]], atol=1e-4)


def test_a_fit_moved_on_without_some_rows_is_the_fit_to_the_others() -> None:
    """Where the curve is nearly vertical one linear step leads far beyond it."""
    x = np.linspace(-1.0, 1.0, 60)
    rng = np.random.default_rng(4)
    seen = np.tanh(8.0 * (x - 0.1)) + 0.02 * rng.standard_normal(60)
    rows = np.arange(60) % 3 != 0
    low, high = np.array([0.1, -1.0]), np.array([50.0, 1.0])

    def residual(u: np.ndarray) -> np.ndarray:
        return np.tanh(u[0] * (x - u[1])) - seen

    fit = least_squares(residual, np.array([3.0, 0.0]), low, high, 30)
    alone = least_squares(lambda u: residual(u)[rows], np.array([3.0, 0.0]), low, high, 30)
    np.testing.assert_allclose(moved_on(residual, fit, rows, low, high), residual(alone.point), atol=1e-3)


def test_a_search_that_comes_to_where_another_ended_stops_there() -> None:
    low, high = -FAR, FAR

    def counted(u: np.ndarray) -> np.ndarray:
        calls.append(u)
        return np.array([u[0] ** 2 - 4.0, u[1] - u[0], 0.1 * u[1]])

    calls: list[np.ndarray] = []
    first = least_squares(counted, np.array([1.0, 1.0]), low, high, 30)
    calls.clear()
    alone = least_squares(counted, np.array([5.0, 0.0]), low, high, 30)
    needed = len(calls)
    calls.clear()
    again = least_squares(counted, np.array([5.0, 0.0]), low, high, 30, before=first)
    np.testing.assert_allclose(again.point, alone.point, atol=0.05)
    assert len(calls) < needed
    calls.clear()
    assert least_squares(counted, first.point, low, high, 30, before=first) is first
    assert len(calls) == 1
    other = least_squares(counted, np.array([-5.0, 0.0]), low, high, 30, before=first)
    assert other.point[0] < 0.0, "another minimum is found"


def test_a_search_far_behind_ends_where_it_goes_on_slowly() -> None:
    def bent(u: np.ndarray) -> np.ndarray:
        return np.array([np.exp(-u[0]), 10.0])

    long = least_squares(bent, np.zeros(1), np.zeros(1), np.array([40.0]), 30, tolerance=0.0)
    short = least_squares(bent, np.zeros(1), np.zeros(1), np.array([40.0]), 30, tolerance=0.0, beaten=5.0)
    assert short.settled and short.evaluations < long.evaluations
    free = least_squares(bent, np.zeros(1), np.zeros(1), np.array([40.0]), 30, tolerance=0.0, beaten=1e3)
    assert free.evaluations == long.evaluations


def test_a_rough_fit_goes_on_as_cautiously_as_it_was_refused() -> None:
    """Three steps from a bend are all too long with a wrong slope; with the true one and more damping the valley is followed."""
    start, wrong = np.array([-1.2, 1.44]), np.array([[0.1, 10.0], [-1.0, 0.0]])
    refused = refine(rosenbrock, start, wrong, np.arange(0), -FAR, FAR, 4, damping=1e-6)
    np.testing.assert_array_equal(refused.point, start)
    assert refused.damping > 1e-4
    on = refine(rosenbrock, refused.point, refused.jacobian, np.arange(2), -FAR, FAR, 4, refused.damping, step=1e-3)
    assert on.cost < 0.9 * refused.cost
