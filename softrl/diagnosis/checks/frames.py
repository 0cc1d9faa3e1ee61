"""In which frames the tip was recorded: whether they turn apart between sessions, or all against the base frame."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softrl.diagnosis.checks.data import Data
from softrl.recordings.check import RunCheck, is_elsewhere, tip_at_rest
from softrl.recordings.placement import Registration, joined, place
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
OTHER_FRAME_RAD = 0.3  # sessions whose best placements turn apart by more were recorded in different frames
TURNED_FRAME_RAD = 1.0  # the whole motion turned by more than this against the base frame is no misalignment
MISPLACED_SHARE = 0.5  # of the squared error under a common placement


def sagging_alike(data: Data, simulated: Sequence[Recording], robot: Robot) -> Data:
    """Return the data without complaints of a tip that rests where the simulator has it: a soft robot that lies sags.

    Parameters
    ----------
    simulated : what the simulator does under the commands of the runs
    """
    rests = [rest for made in simulated if (rest := tip_at_rest(made, robot)) is not None]
    if not rests:
        return data
    expected = np.median(rests, axis=0)

    def mended(told: RunCheck) -> RunCheck:
        if told.rest is None or not told.misplaced or is_elsewhere(told.rest, expected, robot):
            return told
        return replace(told, misplaced="", warnings=tuple(line for line in told.warnings if line != told.misplaced))

    runs, shown = (tuple(map(mended, part)) for part in (data.check.runs, data.shown))
    return replace(data, check=replace(data.check, runs=runs), shown=shown)


def in_other_frames(simulated: Sequence[Recording], runs: Sequence[Recording], misplaced: bool) -> bool:
    """Return whether each session has to be placed by itself.

    Parameters
    ----------
    simulated, runs : what the simulator does, and what was measured, run by run
    misplaced : whether a run shows the tip at rest far from where the base frame has it
    """
    apart, turned = _apart(simulated, runs), _turned(simulated, runs)
    if apart < OTHER_FRAME_RAD and turned < TURNED_FRAME_RAD and not misplaced:
        return False
    log.info(
        "sessions use frames that turn apart by %.0f deg, and all by %.0f deg against the base frame, or have another "
        "origin: each is placed by itself",
        np.degrees(apart),
        np.degrees(turned),
    )
    return True


def _apart(simulated: Sequence[Recording], runs: Sequence[Recording]) -> float:
    """Return the largest angle, rad, between the best placements of the simulation in any two sessions' frames.

    A session's own turn counts only if it removes most of the error that the common one leaves there: motion along one line
    fits at any turn about that line, and no motion at any turn at all.
    """
    sessions = dict.fromkeys(run.session for run in runs)
    common, turns = place(*joined(simulated, runs)), []
    for session in sessions:
        p, q = joined(*zip(*[pair for pair in zip(simulated, runs, strict=True) if pair[1].session == session], strict=True))
        own = place(p, q)
        shifted = Registration(common.turn, q.mean(axis=0) - common.turn @ p.mean(axis=0))
        turns.append(own.turn if _misplaced(own, p, q) < MISPLACED_SHARE * _misplaced(shifted, p, q) else common.turn)
    cosines = [0.5 * (np.trace(a.T @ b) - 1.0) for i, a in enumerate(turns) for b in turns[:i]]
    return float(np.arccos(np.clip(min(cosines, default=1.0), -1.0, 1.0)))


def _misplaced(placed: Registration, points: np.ndarray, seen: np.ndarray) -> float:
    return float(np.mean(np.sum((seen - points @ placed.turn.T - placed.shift) ** 2, axis=1)))


def _turned(simulated: Sequence[Recording], runs: Sequence[Recording]) -> float:
    """Return the angle, rad, by which all motion together seems turned against the base frame; 0 where that is unclear.

    A turn counts only if it explains most of the difference between simulated and measured motion.
    """
    points, target = joined(simulated, runs)
    turn, shift = place(points, target)
    plain = np.mean(np.sum((target - target.mean(axis=0) - points + points.mean(axis=0)) ** 2, axis=1))
    placed = np.mean(np.sum((target - points @ turn.T - shift) ** 2, axis=1))
    if placed > 0.25 * plain:
        return 0.0
    return float(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
