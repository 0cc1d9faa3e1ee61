"""Operator inference finds a quadratic law, and says of other laws what it can."""

import numpy as np

from softrl.bench.operator_inference import Motion, others_foretell


def motion(rng: np.random.Generator, cubic: float) -> Motion:
    """Return a driven oscillator in two coordinates of different units, by an explicit scheme that is such a law."""
    load = np.repeat(rng.uniform(-1.0, 1.0, (6, 2)), 10, axis=0)
    path = np.zeros((60, 2))
    for k in range(2, 60):
        x, v = path[k - 1], path[k - 1] - path[k - 2]
        pull = np.array([x[0] + 0.3 * x[0] * x[1], 2.0 * x[1] + 0.2 * x[0] ** 2])
        path[k] = 2.0 * x - path[k - 2] + 0.05 * (load[k] - pull - cubic * x**3) - 0.1 * v
    return load * np.array([1e4, 1.0]), path * np.array([1e-5, 1e-2])


def test_a_quadratic_law_is_found_and_a_cubic_one_missed() -> None:
    for cubic, most, least in ((0.0, 1e-4, 0.0), (2.0, np.inf, 1e-3)):
        rng = np.random.default_rng(3)
        motions = [motion(rng, cubic) for _ in range(6)]
        missed = [np.abs(told - path).max(axis=0) for told, (_, path) in zip(others_foretell(motions), motions, strict=True)]
        share = np.max(missed, axis=0) / np.abs(np.concatenate([path for _, path in motions])).max(axis=0)
        assert (share < most).all() and (share >= least).all(), share
