"""Motions from rest under a program of loads, by implicit time steps."""

from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel


class Trajectory(NamedTuple):
    """A motion of the full model.

    Attributes
    ----------
    load : (steps, chambers + 3) Pa and N, held over the step that ends at that time
    coordinate : (steps, chambers + 3) m^3 and m
    quaternion : (steps, 4) w x y z
    iterations, factorisations : totals over all steps
    """

    load: np.ndarray
    coordinate: np.ndarray
    quaternion: np.ndarray
    iterations: int
    factorisations: int


def roll_out(model: FemModel, load: np.ndarray, dt_s: float, rest: Pose) -> Trajectory:
    """Return the motion from ``rest`` under ``load`` (steps, chambers + 3); row k acts from k dt to (k + 1) dt.

    Raises
    ------
    SolverError
        If a step does not end at a minimum.
    """
    state = model.state(rest)
    coordinates, quaternions = [], []
    iterations = factorisations = 0
    for number, row in enumerate(load):
        state, solve = model.step(state, row, dt_s)
        if solve.failure:
            raise SolverError(f"step {number + 1} of {dt_s:g} s failed, {solve.failure}; a smaller stage.dt_s may help")
        iterations, factorisations = iterations + solve.iterations, factorisations + solve.factorisations
        coordinates.append(model.coordinate(state.pose))
        quaternions.append(model.tip_quaternion(state.pose))
    return Trajectory(load, np.array(coordinates), np.array(quaternions), iterations, factorisations)
