"""From which moment of every run on a fitted effect acts, looked for in the whole run: a fit ends at the nearest of several."""

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, axes_of, fit_trials

MOMENTS = 48  # that are tried in a run, and NEAR of them about the best
NEAR = 16
LOWER = 0.95  # of a fit's cost: a moment at which as much is left, all else the same, is followed


def at_its_moment(fitting: Problem, trial: Trial, search: Search) -> Trial:
    """Return ``trial``, or what it becomes from a moment at which its last effect, beginning then, leaves less.

    What lasts from run to run is looked for so before it is fitted, see ``onset``.
    """
    choice = trial.hypothesis.effects[-1]
    if choice.gate is None or choice.gate.field != "since_s" or choice.lasting:
        return trial
    axis, column = axes_of(trial, choice)["since_s"]
    longest_s = max(float(np.ptp(run.time)) for run in fitting.runs)
    step_s = longest_s / (MOMENTS + 1)
    trial = _followed(fitting, trial, column, [axis.scaled(k * step_s) for k in range(1, MOMENTS + 1)], search)
    here_s = axis.physical(float(trial.fit.point[column]))
    near = np.clip(np.linspace(here_s - step_s, here_s + step_s, NEAR), 0.0, longest_s)
    return _followed(fitting, trial, column, [axis.scaled(moment) for moment in near], search)


def _followed(fitting: Problem, trial: Trial, column: int, moments: list[float], search: Search) -> Trial:
    """Return the better of ``trial`` and a fit from the best of the ``moments``, scaled, if that leaves less from the outset."""
    points = np.tile(trial.fit.point, (len(moments), 1))
    points[:, column] = moments
    costs = [_cost(fitting, trial, point) for point in points]
    if min(costs) >= LOWER * trial.fit.cost:
        return trial
    start = points[int(np.argmin(costs))]
    return min([trial, *fit_trials(fitting, None, [(trial.hypothesis, [start])], search)], key=lambda t: t.mean_square)


def _cost(fitting: Problem, trial: Trial, point: np.ndarray) -> float:
    try:
        left = fitting.residual(trial.hypothesis, point).flat
    except SolverError:
        return np.inf
    return 0.5 * float(left @ left)
