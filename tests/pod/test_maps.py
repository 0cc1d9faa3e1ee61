"""Maps: slopes stand for further samples, and the form is the one that predicts what was left out."""

import numpy as np

from softrl.core.polynomial import basis, count
from softrl.pod.fitting.maps import Seen, best_forms, equations, trust

ORDER, DEGREE = 6, 3


def cubic(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the values (S, 1 + 6, columns) and slopes of a cubic with ``coefficients`` (monomials, columns)."""
    return Seen(points, np.tile(np.eye(ORDER), (len(points), 1, 1))).design(DEGREE) @ coefficients


def test_slopes_are_those_of_the_values() -> None:
    rng = np.random.default_rng(0)
    points, coefficients = rng.uniform(-1.0, 1.0, (4, ORDER)), rng.standard_normal((count(ORDER, DEGREE), 2))
    values = basis(ORDER, DEGREE).values
    for k, step in enumerate(1e-6 * np.eye(ORDER)):
        change = (values(points + step) - values(points - step)) @ coefficients / 2e-6
        np.testing.assert_allclose(cubic(points, coefficients)[:, 1 + k], change, atol=1e-8)


def test_with_slopes_few_samples_tell_a_cubic() -> None:
    """Fifteen samples are 105 equations for its 84 coefficients; without slopes they are fifteen."""
    rng = np.random.default_rng(1)
    coefficients = rng.standard_normal((count(ORDER, DEGREE), 2))
    points, unseen = rng.uniform(-1.0, 1.0, (15, ORDER)), rng.uniform(-1.0, 1.0, (50, ORDER))
    error = []
    for moves in (0, ORDER):
        seen = Seen(points, np.tile(np.eye(ORDER), (len(points), 1, 1))[..., :moves])
        targets = cubic(points, coefficients)[:, : 1 + moves]
        found = equations(seen, targets, np.ones(len(points)), DEGREE, False).solve(1e-14).T
        error.append(np.abs(cubic(unseen, found - coefficients)[:, 0]).max())
    assert error[1] < 1e-6 < 0.1 < error[0]


def test_the_form_is_that_of_the_law() -> None:
    """A square law with noise: neither less than degree 2 nor more, and noisy samples want a ridge."""
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 1.0, (80, ORDER))
    law = np.where(np.arange(count(ORDER, DEGREE)) < count(ORDER, 2), rng.standard_normal(count(ORDER, DEGREE)), 0.0)
    exact = cubic(points, law[:, None])[:, :1]
    seen = Seen(points, np.zeros((len(points), ORDER, 0)))
    ridges, fold = (1e-10, 1e-3), np.arange(len(points)) % 4
    forms = [
        best_forms(
            seen, {"map": exact + noise * rng.standard_normal(exact.shape)}, np.ones(80), fold, slice(None), {"map": 3}, False,
            ridges,
        )["map"]
        for noise in (0.0, 1.0)
    ]
    assert forms[0].degree == 2 and forms[0].ridge == 1e-10 and forms[0].error < 1e-12
    assert forms[1].ridge == 1e-3 and forms[1].error > 0.5


def test_samples_that_no_polynomial_follows_do_not_lead_the_others_astray() -> None:
    """Of eighty samples five have slopes twenty times as steep as the cubic that all others are of."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (80, ORDER))
    seen = Seen(points, np.tile(np.eye(ORDER), (80, 1, 1)))
    law = rng.standard_normal((count(ORDER, DEGREE), 2))
    targets = {"map": cubic(points, law) + 1e-3 * rng.standard_normal((80, 1 + ORDER, 2))}
    targets["map"][:5, 1:] *= 20.0
    unseen, even = rng.uniform(-1.0, 1.0, (50, ORDER)), np.ones(80)
    weight = trust(seen, targets, even, {"map": DEGREE}, False)
    assert weight[:5].max() < 1e-3 and weight[5:].min() > 0.3, (weight[:5], weight[5:].min())
    error = [
        np.abs(cubic(unseen, equations(seen, targets["map"], each, DEGREE, False).solve(1e-10).T - law)[:, 0]).max()
        for each in (even, weight)
    ]
    assert error[1] < 0.01 < 1.0 < error[0], error
