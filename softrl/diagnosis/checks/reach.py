"""How far the tip is from the base at rest, beside the length that the robot's file gives."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.checks.mistaken import still
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

OTHER_LENGTH = 0.03  # of the length, by which the tip may be nearer or farther: weight and pressure left over do as much
ALIKE = 0.02  # of the length: sessions that differ by more differ in something else
AT_FIRST_S = 0.2


def of_other_length(runs: Sequence[Recording], robot: Robot) -> str | None:
    """Return in a sentence that the tip at rest is not where a robot of this length has it, or None.

    By runs that begin without pressure, if they agree. A marker beyond the tip shows so, too: which of both it is no recording
    of the tip can tell.
    """
    if robot.output == "bend_angle":
        return None
    reach = [_reach(run) for run in runs if still(run, robot)[_at_first(run)].all()]
    if not reach or np.ptp(reach) > ALIKE * robot.length_m:
        return None
    found = float(np.median(reach))
    if abs(found - robot.length_m) <= OTHER_LENGTH * robot.length_m:
        return None
    return (
        f"at rest the tip is {1e3 * found:.4g} mm from the base, and length_m of robot {robot.name} is "
        f"{1e3 * robot.length_m:.4g} mm: measure it again. If it is right, the marker sits before or beyond the tip, or the "
        "camera's scale is wrong; if it is not, marker_offset, or an offset of all chambers, may be named for it"
    )


def _at_first(run: Recording) -> np.ndarray:
    return np.asarray(run.time <= run.time[0] + AT_FIRST_S)


def _reach(run: Recording) -> float:
    return float(np.linalg.norm(np.median(np.asarray(run.position)[_at_first(run)], axis=0)))
