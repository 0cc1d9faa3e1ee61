"""Operator inference: a quadratic law of motion learnt from motions alone, a baseline for bodies that know equations."""

from collections.abc import Sequence

import numpy as np

RIDGES = tuple(10.0**k for k in range(-8, 1))  # of a law in scaled coordinates
RUNAWAY = 10.0  # times the largest coordinate: farther is not computed

Motion = tuple[np.ndarray, np.ndarray]  # loads (steps, r) and coordinates (steps, r)


def others_foretell(motions: Sequence[Motion]) -> list[np.ndarray]:
    """Return for each motion what a law that is fitted to all others makes of its loads, from its first two steps on."""
    scaled, coordinate = _scaled(motions)
    return [
        _roll(_chosen([m for k, m in enumerate(scaled) if k != left_out]), motion) * coordinate
        for left_out, motion in enumerate(scaled)
    ]


def _scaled(motions: Sequence[Motion]) -> tuple[list[Motion], np.ndarray]:
    load, coordinate = (np.maximum(np.abs(np.concatenate(rows)).max(axis=0), 1e-300) for rows in zip(*motions, strict=True))
    return [(loads / load, path / coordinate) for loads, path in motions], coordinate


def _chosen(motions: Sequence[Motion]) -> np.ndarray:
    """Return the law of the ridge whose laws, each without one motion, roll out best along that one."""
    if len(motions) == 1:
        return _law(motions, RIDGES[len(RIDGES) // 2])

    def missed(ridge: float) -> float:
        laws = (_law([m for m in motions if m is not left_out], ridge) for left_out in motions)
        return sum(float(((_roll(law, m) - m[1]) ** 2).sum()) for law, m in zip(laws, motions, strict=True))

    return _law(motions, min(RIDGES, key=missed))


def _law(motions: Sequence[Motion], ridge: float) -> np.ndarray:
    """Return W (features, r): acceleration per step squared is features W, least squares with a ``ridge``."""
    rows = [_features(path[1:-1], path[:-2], loads[2:]) for loads, path in motions]
    bends = [path[2:] - 2.0 * path[1:-1] + path[:-2] for _, path in motions]
    x, y = np.concatenate(rows), np.concatenate(bends)
    return np.asarray(np.linalg.solve(x.T @ x + ridge * len(x) * np.eye(x.shape[1]), x.T @ y))


def _features(now: np.ndarray, before: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return (steps, features): a constant, where the body is and all products of that, its last move, and the load."""
    first, second = np.triu_indices(now.shape[1])
    return np.hstack([np.ones((len(now), 1)), now, now[:, first] * now[:, second], now - before, load])


def _roll(law: np.ndarray, motion: Motion) -> np.ndarray:
    loads, path = motion
    found = np.repeat(path[1:2], len(path), axis=0)
    found[:2] = path[:2]
    for k in range(2, len(path)):
        now, before = found[k - 1 : k], found[k - 2 : k - 1]
        ahead = (2.0 * now - before + _features(now, before, loads[k : k + 1]) @ law)[0]
        found[k] = np.clip(ahead, -RUNAWAY, RUNAWAY)
    return found
