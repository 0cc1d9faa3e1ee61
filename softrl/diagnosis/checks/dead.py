"""Gauges that show nothing of what is commanded: all of them are dead, and the motion is examined without."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softrl.recordings.recording import Recording
from softrl.recordings.validate import follows
from softrl.robots.robot import Robot

QUIET = 0.05  # of the largest command: a gauge that moves more shows something


def without_dead_gauges(runs: Sequence[Recording], robot: Robot) -> tuple[list[Recording], list[str]]:
    """Return the runs without measured pressures if these stay in their noise whatever is commanded, and a sentence on that.

    None of which follows its commands: gauges in another unit do. Where commands are no pressures nobody knows.
    """
    seen = [run for run in runs if run.pressure_meas is not None]
    if not seen or robot.command != "pressure":
        return list(runs), []
    commands = np.concatenate([run.pressure_cmd for run in seen])
    measured = np.concatenate([np.asarray(run.pressure_meas) for run in seen])
    most, asked = float(np.ptp(measured, axis=0).max()), float(np.ptp(commands, axis=0).max())
    if most > QUIET * asked or follows(commands, measured):
        return list(runs), []
    told = f"no gauge moves by more than {1e-3 * most:.3g} kPa where {1e-3 * asked:.3g} kPa are commanded: dead, and left out"
    return [replace(run, pressure_meas=None) for run in runs], [told]
