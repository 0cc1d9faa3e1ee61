import numpy as np

from softrl.fem.secants import Secants


class Stale:
    """Solves with a matrix that is not the one at hand."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix = matrix

    def factorise(self, upper: object) -> bool:
        raise AssertionError("secants make no factors")

    def solve(self, right: np.ndarray) -> np.ndarray:
        return np.linalg.solve(self.matrix, right)


def stiff_and_stale(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    shape = rng.standard_normal((30, 30))
    stiff = shape @ shape.T + 30.0 * np.eye(30)
    soft = rng.standard_normal((30, 3))
    return stiff, stiff + 4.0 * soft @ soft.T


def steps_until(matrix: np.ndarray, stale: np.ndarray, right: np.ndarray, *, learns: bool) -> int:
    secants, left, x = Secants(Stale(stale)), right.copy(), np.zeros_like(right)
    for count in range(500):
        if np.abs(left).max() < 1e-10 * np.abs(right).max():
            return count
        step = secants.solve(left)
        if learns:
            secants.learn(step, matrix @ step)
        x, left = x + step, left - matrix @ step
    return 500


def test_what_was_learnt_last_is_met_exactly() -> None:
    matrix, stale = stiff_and_stale(0)
    secants = Secants(Stale(stale))
    for step in np.random.default_rng(1).standard_normal((5, 30)):
        secants.learn(step, matrix @ step)
        np.testing.assert_allclose(secants.solve(matrix @ step), step, rtol=1e-10, atol=1e-10)


def test_soft_directions_that_stale_factors_miss_are_learnt() -> None:
    matrix, stale = stiff_and_stale(2)
    right = np.random.default_rng(3).standard_normal(30)
    assert steps_until(matrix, stale, right, learns=True) < 0.3 * steps_until(matrix, stale, right, learns=False)


def test_a_step_that_lowers_its_own_resistance_teaches_nothing() -> None:
    stale = np.eye(4)
    secants = Secants(Stale(stale))
    secants.learn(np.array([1.0, 0, 0, 0]), np.array([-1.0, 0, 0, 0]))
    secants.learn(np.zeros(4), np.zeros(4))
    np.testing.assert_array_equal(secants.solve(np.arange(4.0)), np.arange(4.0))
