"""Values over the steps of a grid, between which they change."""

from typing import NamedTuple

import numpy as np


class Span(NamedTuple):
    """Values (steps, n): the ``mean`` over each step, and those at its ``end``.

    They differ where values change within steps, as pressures do behind a slow valve; elsewhere both are one array.
    """

    mean: np.ndarray
    end: np.ndarray


def held(values: np.ndarray | Span) -> Span:
    """Return ``values`` as a span; those of an array (steps, n) are held over each step."""
    return values if isinstance(values, Span) else Span(values, values)


def after(first: np.ndarray, span: Span) -> Span:
    """Return ``span`` with ``first`` (rows, n) in place of its first rows."""
    mean = np.vstack([first, span.mean[len(first) :]])
    return held(mean) if span.end is span.mean else Span(mean, np.vstack([first, span.end[len(first) :]]))
