"""Where along the body the mismatch sits, told by markers between base and tip.

The simulated centreline is that through the simulated pose of the tip, the measured one the markers. A piece between two
markers that bends otherwise than simulated turns all that is above it, and nothing below.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.diagnosis.fitting.flexible import pressures
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.judging.locate import BLOCK_S, Finding
from softrl.diagnosis.series.statistics import follows
from softrl.recordings.placement import Registration
from softrl.recordings.recording import Recording

BENDS = "bends"  # how the region of each test begins
REST_SHARE = 0.02  # of a run's largest pressure: samples below show the body at rest
REST_SAMPLES = 5  # of them at least, to place a marker
SHRINK = 0.02  # of the squares: neighbouring pieces that bend against each other are noise of the marker between them
APART = 0.05  # of the length: markers closer than this to the base, the tip or each other say nothing about a piece
CLOSER = 6  # times that the centreline is brought closer to the tip
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


class Marker(NamedTuple):
    """A marker's name, its height at rest as a share of the body's length, and where it sits beside the centreline, m."""

    name: str
    share: float
    beside: np.ndarray


def along_the_body(problem: Problem, trial: Trial, site: str) -> list[Finding]:
    """Return, for each piece of the body between markers, its share of the bending that the ``trial`` gets wrong.

    Uncorrected tests, see ``locate.corrected``: does that bending follow the pressures? Nothing without two markers or more
    that every run has and shows at rest, nor where sessions are placed separately: heights count from the base, of which nothing
    is known there.
    """
    markers = [] if problem.register else _markers(problem)
    if not markers:
        return []
    heights = np.array([0.0, *(marker.share for marker in markers), 1.0]) * problem.robot.length_m
    more, turns = _turns_of_pieces(problem, trial, markers, heights)
    power = np.maximum(sum(np.sum(run**2, axis=(0, 2)) - _noise(run) for run in turns), 0.0)
    power /= max(power.sum(), np.finfo(float).tiny)
    names = ["the base", *(f"{marker.name} ({marker.share:.0%} of the length)" for marker in markers), "the tip"]
    found = []
    for j, (low, high) in enumerate(pairwise(names)):
        region = f"{BENDS} {'more' if more[j] else 'less'} than simulated between {low} and {high}"
        found.append(Finding(site, None, None, region, float(power[j]), _chance(problem, turns, j)))
    return found


def _turns_of_pieces(
    problem: Problem, trial: Trial, markers: Sequence[Marker], heights: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return whether each piece (pieces,) bends more than simulated, and by how much (bins, pieces, 2) rad, run by run."""
    simulated = problem.replayed(trial.hypothesis, trial.fit.point, ("position", "quaternion"))
    placed = problem.residual(trial.hypothesis, trial.fit.point, trial.placed).registrations
    along, turns = np.zeros(len(heights) - 1), []
    for k, made in enumerate(simulated):
        there = _points(made, markers, placed.get(made.session))
        seen = [problem.runs[k].markers[marker.name] for marker in markers] + [np.asarray(problem.runs[k].position)]
        apart = [problem.binned(k, a - b) for a, b in zip(seen, there, strict=True)]
        moved = [problem.binned(k, b - b[0]) for b in there]
        turns.append(_turns(apart, heights))
        along += np.sum(turns[-1] * _turns(moved, heights), axis=(0, 2))
    return along > 0.0, turns


def _markers(problem: Problem) -> list[Marker]:
    """Return the markers that all runs have between base and tip, from below; where they sit is seen at rest."""
    if problem.robot.output == "bend_angle":
        return []
    common = set.intersection(*(set(run.markers) for run in problem.runs))
    found = []
    for name in sorted(common):
        rest = [run.markers[name][_at_rest(run)] for run in problem.runs]
        seen = np.concatenate(rest)
        if len(seen) >= REST_SAMPLES:
            x, y, z = np.median(seen, axis=0)
            found.append(Marker(name, float(z / problem.robot.length_m), np.array([x, y, 0.0])))
    found = [marker for marker in sorted(found, key=lambda marker: marker.share) if APART < marker.share < 1.0 - APART]
    return [marker for k, marker in enumerate(found) if k == 0 or marker.share - found[k - 1].share > APART]


def _at_rest(run: Recording) -> np.ndarray:
    """Return the samples (steps,) before anything acts for the first time."""
    acting = np.abs(run.pressure_cmd if run.pressure_meas is None else run.pressure_meas).max(axis=1)
    return np.asarray(np.maximum.accumulate(acting) <= REST_SHARE * acting.max())


def _points(made: Recording, markers: Sequence[Marker], placed: Registration | None) -> list[np.ndarray]:
    """Return where (steps, 3) m a simulation has the markers and the tip."""
    return [
        *(_seen_from(_on_the_centreline(made, marker), placed) for marker in markers),
        _seen_from(np.asarray(made.position), placed),
    ]


def _seen_from(points: np.ndarray, placed: Registration | None) -> np.ndarray:
    return points if placed is None else points @ placed.turn.T + placed.shift


def _on_the_centreline(made: Recording, marker: Marker) -> np.ndarray:
    """Return where (steps, 3) the marker is on a centreline that ends where the tip is and as it leans.

    Its tangent is turned by ``b s + c (s - s^2)`` at the share s of the length: b turns the tip, and c, which loads bring about,
    moves it without turning it. Length and c follow from where the tip is; what it is off at the begin (an offset, or a load
    that stays) is shared out along the body.
    """
    bend, tip = Rotation.from_quat(np.asarray(made.quaternion), scalar_first=True).as_rotvec(), np.asarray(made.position)
    change = np.zeros_like(bend)
    for _ in range(CLOSER):
        whole = _integrated(bend, change, 1.0)
        off = tip * (np.linalg.norm(whole, axis=1) / np.linalg.norm(tip, axis=1))[:, None] - whole
        change[:, 0] -= 6.0 * off[:, 1]
        change[:, 1] += 6.0 * off[:, 0]
    change -= change[0]
    whole, part = (_integrated(bend, change, end) for end in (1.0, marker.share))
    long = np.linalg.norm(tip, axis=1) / np.linalg.norm(whole, axis=1)
    curve = long[:, None] * part + marker.share * (tip - long[:, None] * whole)
    return np.asarray(curve + _lean(bend, change, marker.share).apply(marker.beside))


def _lean(bend: np.ndarray, change: np.ndarray, share: float) -> Rotation:
    return Rotation.from_rotvec(share * bend + (share - share**2) * change)


def _integrated(bend: np.ndarray, change: np.ndarray, end: float) -> np.ndarray:
    """Return the integral (steps, 3) of the tangent over the shares of the length from 0 to ``end``."""
    parts = [
        0.5 * end * w * _lean(bend, change, 0.5 * end * (x + 1.0)).apply([0.0, 0.0, 1.0])
        for x, w in zip(NODES, WEIGHTS, strict=True)
    ]
    return np.asarray(sum(parts))


def _turns(points: Sequence[np.ndarray], heights: np.ndarray) -> np.ndarray:
    """Return by how much (bins, pieces, 2) rad each piece is bent where ``points`` (bins, 3) are off a straight body.

    A piece that bends turns itself by half of that on the mean and all pieces above by all of it; small angles.
    """
    path = np.stack([np.zeros_like(points[0]), *points], axis=1)[:, :, :2]
    slopes = np.diff(path, axis=1) / np.diff(heights)[None, :, None]
    pieces = slopes.shape[1]
    turned = np.tril(np.ones((pieces, pieces)), -1) + 0.5 * np.eye(pieces)
    inverse = np.linalg.solve(turned.T @ turned + SHRINK * np.eye(pieces), turned.T)
    return np.asarray(np.einsum("jk,bkc->bjc", inverse, slopes))


def _noise(turns: np.ndarray) -> np.ndarray:
    """Return the squares (pieces,) of white noise in ``turns`` (bins, pieces, 2), summed: by second differences."""
    second = np.diff(turns, n=2, axis=0)
    return np.asarray(np.sum(second**2, axis=(0, 2)) / 6.0 * len(turns) / max(len(second), 1))


def _chance(problem: Problem, turns: Sequence[np.ndarray], piece: int) -> float:
    """Return the chance that the extra bending of a piece follows any chamber's pressure as it does without a reason."""
    mine = [run[:, piece] - run[:, piece].mean(axis=0) for run in turns]
    axis = np.linalg.svd(np.concatenate(mine), full_matrices=False)[2][0]
    drives = [pressures(problem, k) for k in range(len(problem.runs))]
    length = max(round(BLOCK_S / problem.numerics.bin_s), 1)
    chances = [
        follows([run @ axis for run in mine], [drive[:, i] for drive in drives], length)[1]
        for i in range(problem.robot.chambers)
    ]
    return min(1.0, len(chances) * min(chances))
