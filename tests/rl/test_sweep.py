"""A sweep over alpha says whether position is traded for force, and draws it."""

import numpy as np
import pytest

from softrl.core.sweep import Point
from softrl.rl.sweep import Trade, draw, trade, verdict

SCALES = (2.0, 0.3)
ALPHA = np.array([0.1, 0.5, 0.9])


def traded(position: list[float], force: list[float], spread: float = 0.0) -> Trade:
    """Return errors by alpha, each spread over the seeds by a share of a unit."""
    return Trade(ALPHA, np.array(position), np.full(3, spread), np.array(force), np.full(3, spread))


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (traded([1.0, 0.6, 0.3], [0.2, 0.4, 0.9]), "a trade-off: 3 of 3"),
        (traded([1.0, 1.2, 0.3], [0.2, 0.4, 0.9]), "a trade-off: 2 of 3"),
        (traded([27.0, 12.0, 7.0], [1.15, 1.15, 1.15]), "alpha 0.9 is best in both"),  # the surface was not found
        (traded([0.011, 0.010, 0.012], [0.001, 0.002, 0.0005]), "one point"),  # less than the reward feels
        (traded([1.0, 0.9, 0.8], [0.2, 0.3, 0.4], 0.3), "one point"),  # less than the seeds spread
    ],
)
def test_the_words_are_those_of_the_points(found: Trade, words: str) -> None:
    assert words in verdict(found, SCALES)


def point(alpha: str, seed: int, position: float, force: float) -> Point:
    """Return one run of a sweep."""
    errors = {"position_rmse_mm": position, "force_rmse_n": force}
    metrics = {f"heldout/{who}circle_{name}": value + 0.01 * seed for who in ("", "expert_", "rest_")
               for name, value in errors.items()}  # fmt: skip
    params = {"alpha": alpha, "seed": str(seed), "task.position_scale_m": "0.002", "task.force_scale_n": "0.3"}
    return Point(params, metrics)


def test_a_point_stands_for_an_alpha_and_bars_for_its_seeds() -> None:
    points = [point(a, seed, x, y) for a, x, y in (("0.9", 0.3, 0.9), ("0.1", 1.0, 0.2)) for seed in (0, 2)]
    found = trade(points, "circle")
    np.testing.assert_allclose(found.alpha, [0.1, 0.9])
    np.testing.assert_allclose(found.position, [1.01, 0.31])
    np.testing.assert_allclose(found.force_spread, 0.01)
    figure = draw(points)["alpha"]
    (axis,) = figure.axes
    assert axis.get_xlabel().endswith("[mm]") and axis.get_ylabel().endswith("[N]")
    assert "a trade-off: 2 of 2" in axis.get_title()
    labels = {text.get_text() for text in axis.get_legend().get_texts()}
    assert labels == {"Pareto front of the means", "model-based expert", "alpha 0.1", "alpha 0.9"}
