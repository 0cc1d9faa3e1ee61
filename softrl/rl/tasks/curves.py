"""Closed target curves of unit size, (points, 3) each, in a frame whose third axis is the normal of the drawing plane."""

from collections.abc import Callable

import numpy as np

STAR_POINTS = 5
STAR_INNER = 0.45  # radius of the inner corners
EIGHT_HEIGHT = 0.25  # amplitude across the drawing plane


def circle(points: int) -> np.ndarray:
    """Return a circle of radius 1."""
    phase = _phase(points)
    return np.column_stack([np.cos(phase), np.sin(phase), np.zeros(points)])


def star(points: int) -> np.ndarray:
    """Return a five-pointed star of outer radius 1, walked at constant speed."""
    angle = np.pi / 2 + np.pi / STAR_POINTS * np.arange(2 * STAR_POINTS + 1)
    radius = np.where(np.arange(len(angle)) % 2 == 0, 1.0, STAR_INNER)
    corner = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corner, axis=0), axis=1))])
    at = length[-1] * np.arange(points) / points
    return np.column_stack([np.interp(at, length, corner[:, 0]), np.interp(at, length, corner[:, 1]), np.zeros(points)])


def figure_eight(points: int) -> np.ndarray:
    """Return a figure-eight of half-length 1 whose two loops tilt out of the drawing plane."""
    phase = _phase(points)
    return np.column_stack([np.sin(phase), 0.5 * np.sin(2.0 * phase), EIGHT_HEIGHT * np.cos(phase)])


def random_fourier(points: int, harmonics: int, height: float, rng: np.random.Generator) -> np.ndarray:
    """Return a random closed curve within the unit ball; ``height`` scales its extent across the drawing plane."""
    phase = _phase(points)
    curve = np.zeros((points, 3))
    for order in range(1, harmonics + 1):
        cosine, sine = rng.normal(size=(2, 3)) / order
        curve += np.cos(order * phase)[:, None] * cosine + np.sin(order * phase)[:, None] * sine
    curve += rng.normal(size=3) * 0.7
    curve[:, 2] *= height
    return curve / np.linalg.norm(curve, axis=1).max()


CURVES: dict[str, Callable[[int], np.ndarray]] = {"circle": circle, "star": star, "figure_eight": figure_eight}


def _phase(points: int) -> np.ndarray:
    return 2.0 * np.pi * np.arange(points) / points
