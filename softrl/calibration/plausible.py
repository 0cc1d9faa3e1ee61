"""What is odd about recordings is told before pressures are made responsible for it."""

import logging
from collections.abc import Sequence

import numpy as np

from softrl.calibration.replay import Stepping, replay
from softrl.core.errors import RecordingError
from softrl.effects.chain import Plant
from softrl.recordings.check import check
from softrl.recordings.mistaken import mistaken
from softrl.recordings.placement import joined, place
from softrl.recordings.recording import Recording, RecordingSet

log = logging.getLogger(__name__)
PLACED_SHARE = 0.5  # of the squared error, left by a rigid motion of a session's frame: less, and the frame may be what differs


def look_over(recordings: RecordingSet, plant: Plant, stepping: Stepping, tolerance_m: float) -> None:
    """Warn of what is odd about ``recordings``, and of frames that seem to be off by more than ``tolerance_m``.

    Raises
    ------
    RecordingError
        If their columns cannot be what they are called, beside what the ``plant`` does under their commands.
    """
    robot = plant.chain.robot
    for line in check(recordings, robot).warnings:
        log.warning("%s", line)
    channel = "bend_angle" if robot.output == "bend_angle" else "position"
    made = replay(plant, recordings.recordings, lambda pressure: pressure, stepping)
    pairs = [pair for pair in zip(recordings.recordings, made, strict=True) if getattr(pair[0], channel) is not None]
    if not pairs:
        return
    runs, simulated = zip(*pairs, strict=True)
    told = mistaken(runs, simulated, robot)
    if told is not None:
        raise RecordingError(f"the recordings of {robot.name} cannot be what they are called: {told}")
    if channel == "position":
        _warn_of_frames(runs, simulated, tolerance_m)


def _warn_of_frames(runs: Sequence[Recording], simulated: Sequence[Recording], tolerance_m: float) -> None:
    """Warn of sessions in which a rigid motion of the frame explains most of how far tips are from what is simulated."""
    for session in dict.fromkeys(run.session for run in runs):
        mine = [k for k, run in enumerate(runs) if run.session == session]
        points, seen = joined([simulated[k] for k in mine], [runs[k] for k in mine])
        turn, shift = place(points, seen)
        plain, placed = (np.mean(np.sum((seen - tips) ** 2, axis=1)) for tips in (points, points @ turn.T + shift))
        if placed < PLACED_SHARE * plain and np.sqrt(plain - placed) > tolerance_m:
            log.warning(
                "session %s: a frame turned by %.3g deg would explain %.0f %% of the squared distance, %.3g mm rms, between "
                "recorded and simulated tips; f_RS takes it for pressure: check the frame, unless pressures are off by constants",
                session, np.degrees(np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))),
                100.0 * (1.0 - placed / plain), 1e3 * np.sqrt(plain),
            )  # fmt: skip
