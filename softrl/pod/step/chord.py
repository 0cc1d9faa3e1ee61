"""The square of a step in a metric that changes on the way: ``by' A by`` with A half way, to third order, compiled.

A is ``L S'S L'``, S symmetric with polynomials for entries and L constant, lower triangular: positive wherever they lead.
"""

from typing import Any

import numpy as np

from softrl.core.compiled import borrowing, summing
from softrl.pod.step.potential import fill_monomials, fill_rows, fill_square, to_ball


@borrowing
def fill_metric(metric: Any, values: np.ndarray, work: Any, matrix: np.ndarray) -> None:
    """Fill A (r, r) at monomials ``values``, of ``metric`` as in ``fill_chord``; ``work`` then holds S L', its ``root``."""
    entries, factor = metric
    fill_rows(entries, values[: entries.shape[1]], work.half)
    _fill_root(work.half, factor, work.root)
    fill_square(work.root, matrix)


@borrowing
def fill_chord(
    metric: Any, middle: np.ndarray, by: np.ndarray, least: int, tables: Any, work: Any, matrix: np.ndarray,
    slope: np.ndarray,
) -> None:
    """Fill A (r, r) at ``middle`` and a quarter of the gradient there of ``by' A by``, ``slope`` (r,).

    By the arrival at its end half the square of a step has the derivative ``A by + slope``.

    Parameters
    ----------
    metric : entries of S (pairs, k) and L (r, r)
    least : number of monomials that ``work`` is to hold afterwards, besides S L', its ``root`` (r r,)
    """
    (entries, factor), values, point, weights, mixed = metric, work.values, work.point, work.weights, work.mixed
    radius, some = to_ball(middle, point), values[: entries.shape[1]]
    fill_monomials(point, tables.parent, tables.variable, values[: max(least, entries.shape[1])])
    fill_metric(metric, values, work, matrix)
    _fill_weights(work.root, factor, by, work.scratch, weights)
    mixed[: len(some)] = 0.0
    _add_mixture(entries, weights, mixed)
    _fill_slope(mixed, some, point, radius, tables, slope)


@borrowing
def _fill_root(half: np.ndarray, factor: np.ndarray, root: np.ndarray) -> None:
    """Fill ``root`` (r r,) with S L' of the entries ``half`` (pairs,) of S and ``factor`` L."""
    r = len(factor)
    root[:] = 0.0
    pair = 0
    for a in range(r):
        for c in range(a, r):
            for b in range(c, r):
                root[a * r + b] += half[pair] * factor[b, c]
            for b in range(a, r if c > a else a):
                root[c * r + b] += half[pair] * factor[b, a]
            pair += 1


@borrowing
def _fill_weights(
    root: np.ndarray, factor: np.ndarray, by: np.ndarray, scratch: np.ndarray, weights: np.ndarray
) -> None:
    """Fill the derivatives ``weights`` (pairs,) of ``|S L' by|^2`` by the entries of S; ``scratch`` (r, r)."""
    r, moved, led = len(by), scratch[0], scratch[1]
    for a in range(r):
        moved[a] = led[a] = 0.0
        for b in range(r):
            moved[a] += root[a * r + b] * by[b]
        for b in range(a, r):
            led[a] += factor[b, a] * by[b]
    pair = 0
    for a in range(r):
        for c in range(a, r):
            weights[pair] = 2.0 * (moved[a] * led[c] + (moved[c] * led[a] if c > a else 0.0))
            pair += 1


@summing
def _add_mixture(coefficients: np.ndarray, weights: np.ndarray, mixed: np.ndarray) -> None:
    """Add to ``mixed`` (>= k,) the polynomials ``coefficients`` (m, k), weighed by ``weights`` (m,).

    Four at a time, the last ones with no weight where m is no multiple.
    """
    last = len(weights) - 1
    for first in range(0, last + 1, 4):
        m, n, o = min(first + 1, last), min(first + 2, last), min(first + 3, last)
        a, b = weights[first], weights[m] if m > first else 0.0
        c, d = weights[n] if n > m else 0.0, weights[o] if o > n else 0.0
        for k in range(coefficients.shape[1]):
            mixed[k] += (
                a * coefficients[first, k] + b * coefficients[m, k] + c * coefficients[n, k] + d * coefficients[o, k]
            )


@borrowing
def _fill_slope(
    mixed: np.ndarray, values: np.ndarray, point: np.ndarray, radius: float, tables: Any, slope: np.ndarray
) -> None:
    """Fill a quarter of the gradient by the state, ``slope`` (r,), of the polynomial ``mixed``, which is used up.

    ``values`` (k,) are the monomials at ``point``, the image in the unit ball of the state at ``radius``: outside, a map is
    that at the image.
    """
    slope[:] = 0.0
    for k in range(len(values) - 1, 0, -1):
        lower, along = tables.parent[k], tables.variable[k]
        slope[along] += mixed[k] * values[lower]
        mixed[lower] += mixed[k] * point[along]
    outward = 0.0
    for i in range(len(point)):
        outward += point[i] * slope[i] if radius > 1.0 else 0.0
    for i in range(len(point)):
        slope[i] = 0.25 * (slope[i] - point[i] * outward) / max(radius, 1.0)
