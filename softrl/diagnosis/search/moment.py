"""From which moment on a fitted effect acts, looked for in all the time that its clock goes on: a fit ends at the nearest."""

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import MOMENTS
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, axes_of, fit_trials
from softrl.diagnosis.search.onset import moments

TRIED = 48  # moments in all the time, and NEAR of them about the best
NEAR = 16
LOWER = 0.95  # of a fit's cost: a moment at which as much is left, all else the same, is followed


def at_its_moment(fitting: Problem, trial: Trial, search: Search) -> Trial:
    """Return ``trial``, or what it becomes from a moment at which its last effect, beginning then, leaves less."""
    choice = trial.hypothesis.effects[-1]
    axes = axes_of(trial, choice)
    moment = next((name for name in axes if name in MOMENTS), None)
    if moment is None:
        return trial
    axis, column = axes[moment]
    longest_s = float(np.max(moments(fitting, choice.lasting, choice.sessions)))
    step_s = longest_s / (TRIED + 1)
    trial = _followed(fitting, trial, column, [axis.scaled(k * step_s) for k in range(1, TRIED + 1)], search)
    here_s = axis.physical(float(trial.fit.point[column]))
    near = np.clip(np.linspace(here_s - step_s, here_s + step_s, NEAR), 0.0, longest_s)
    return _followed(fitting, trial, column, [axis.scaled(moment) for moment in near], search)


def _followed(fitting: Problem, trial: Trial, column: int, tried: list[float], search: Search) -> Trial:
    """Return the better of ``trial`` and a fit from the best moment ``tried``, scaled, if that leaves less at once."""
    points = np.tile(trial.fit.point, (len(tried), 1))
    points[:, column] = tried
    costs = parallel(_cost, [(fitting, trial, point) for point in points], search.workers)
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
