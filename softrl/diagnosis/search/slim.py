"""A hypothesis without the parameters that do not pay: fewer say the same."""

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import (
    GATES,
    LASTING,
    MOMENTS,
    Choice,
    Hypothesis,
    effect_axes,
    is_essential,
    may_be_pinned,
)
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.minimise import jacobian_at
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, columns_of
from softrl.diagnosis.search.path import Path
from softrl.effects.gate import WIDTHS
from softrl.effects.library import effect_class

SILENT = 1e-6  # of the largest column: a parameter with less influence on the residual has none
DIFFERENCE = 0.02  # scaled step of derivatives


def slim(fitting: Problem, judge: Judge, trial: Trial, search: Search, path: Path, first: int = 0) -> Trial:
    """Return ``trial`` without the parameters that do not pay: each is pinned at its neutral value and the rest refitted.

    A gate that opens below all pressures, or before anything moves, has no influence: it goes first. A law that says no more
    than one that it contains gives way to it. Effects before the ``first``, counted from 0, stay as they are.
    """
    if any(choice.gate for choice in trial.hypothesis.effects[first:]):
        trial = without_silent(fitting, judge, trial, search, path, first)
    again = True
    while again:
        again = False
        for choice in trial.hypothesis.effects[first:]:
            fields = [*may_be_pinned(choice), *([choice.gate.field] if choice.gate else [])]
            forms = [pinned(mine, choice, held) for mine, held in (_as_first(trial, choice, name) for name in fields)]
            forms = [form for form in forms if effect_axes(form[0].effects[form[2]]) and not form[0].effects[form[2]].retunes]
            forms += _contained(trial, choice)
            fitted = path.fit(fitting, [(hypothesis, point) for hypothesis, point, _ in forms], search, trial)
            fewer = [t for t in fitted if len(t.fit.point) <= len(trial.fit.point)]
            as_good = [t for t in fewer if not judge.tells(t.squares, trial.squares)]
            if as_good:
                slimmer = min(as_good, key=lambda t: t.mean_square)
                place = trial.hypothesis.effects.index(choice)
                path.tried[slimmer.hypothesis.effects[place]] = path.tried.pop(choice, [])
                trial, again = without_silent(fitting, judge, slimmer, search, path, first), True
                break
    return trial


def pinned(trial: Trial, choice: Choice, name: str) -> tuple[Hypothesis, np.ndarray, int]:
    """Return (hypothesis, point, place of the effect) with one more parameter of ``choice`` held at neutral, or no gate."""
    place = trial.hypothesis.effects.index(choice)
    less = without_gate(choice) if name in GATES else choice._replace(pinned=(*choice.pinned, name))
    effects = tuple(less if effect == choice else effect for effect in trial.hypothesis.effects)
    return Hypothesis(effects, trial.hypothesis.tuned), np.delete(trial.fit.point, _gone(trial, choice, name)), place


def _as_first(trial: Trial, choice: Choice, name: str) -> tuple[Trial, str]:
    """Return ``trial`` and which parameter to hold for ``name``: of twins the second, after they exchanged their numbers."""
    first, second = effect_class(choice.name).twins or ((), ())
    axes = {axis.name: (axis, column) for axis, column in zip(effect_axes(choice), columns_of(trial, choice), strict=True)}
    if name not in first or not axes.keys() >= {*first, *second}:
        return trial, name
    point, jacobian = trial.fit.point.copy(), trial.fit.jacobian.copy()
    for one, other in [*zip(first, second, strict=True), *zip(second, first, strict=True)]:
        (taken, column), (given, theirs) = axes[one], axes[other]
        point[column] = taken.scaled(given.physical(float(trial.fit.point[theirs])))
        jacobian[:, column] = trial.fit.jacobian[:, theirs] * (1.0 if taken.log else taken.scale / given.scale)
    return trial._replace(fit=trial.fit._replace(point=point, jacobian=jacobian)), second[first.index(name)]


def _gone(trial: Trial, choice: Choice, name: str) -> np.ndarray:
    """Return the places in the point of ``trial`` of what goes with the parameter ``name`` of ``choice``."""
    names = (name, WIDTHS.get(name))
    return columns_of(trial, choice)[[axis.name in names for axis in effect_axes(choice)]]


def _contained(trial: Trial, choice: Choice) -> list[tuple[Hypothesis, np.ndarray, int]]:
    """Return the same as ``pinned`` with a law that ``choice`` contains in its place: what is never bounded is a lag.

    It begins with the numbers of the same names, what is pinned stays so, and a number of its own is taken from those that both
    laws share: the lag of what fills and vents alike has two.
    """
    law, axes, columns = effect_class(choice.name), effect_axes(choice), columns_of(trial, choice)
    values = {axis.name: axis.physical(u) for axis, u in zip(axes, trial.fit.point[columns], strict=True)}
    shared = [value for name, value in values.items() if name not in (*law.essence, *GATES, *WIDTHS.values())]
    found, place = [], trial.hypothesis.effects.index(choice)
    for name in law.contains:
        held = tuple(field.name for field in effect_class(name).parameter_fields() if field.name in choice.pinned)
        less = choice._replace(name=name, pinned=(*choice.pinned_widths, *held))
        told = [values.get(axis.name, *shared[:1]) for axis in effect_axes(less)]
        if not told or None in told or name in trial.hypothesis.names:
            continue
        begin = [axis.scaled(value) for axis, value in zip(effect_axes(less), told, strict=True)]
        point = np.insert(np.delete(trial.fit.point, columns), columns[0], begin)
        effects = tuple(less if effect == choice else effect for effect in trial.hypothesis.effects)
        found.append((Hypothesis(effects, trial.hypothesis.tuned), point, place))
    return found


def without_gate(choice: Choice) -> Choice:
    """Return ``choice`` as it acts always and everywhere; a clock that counted for the gate goes with it."""
    at_a_time = choice.gate is not None and choice.gate.field == "since_s"
    own = tuple(name for name in choice.pinned if name not in WIDTHS.values())
    return choice._replace(gate=None, pinned=own, lasting="" if at_a_time else choice.lasting)


def _influence(fitting: Problem, trial: Trial) -> np.ndarray:
    """Return the size (p,) of each parameter's derivatives, taken anew: those of a race are in part its rival's."""

    def moved(point: np.ndarray) -> np.ndarray:
        return fitting.residual(trial.hypothesis, point, trial.placed).flat

    low, high = fitting.space(trial.hypothesis).bounds
    columns = jacobian_at(moved, trial.fit.point, moved(trial.fit.point), low, high, DIFFERENCE)
    return np.asarray(np.linalg.norm(columns, axis=0))


def without_silent(
    fitting: Problem, judge: Judge, trial: Trial, search: Search, path: Path, first: int = 0
) -> Trial:
    """Return ``trial`` with the parameters of its effects, from the ``first`` on, pinned that have no influence any more.

    When something began between two fitted runs has no influence where it is, and yet it did not act always.
    """
    size = _influence(fitting, trial)
    for choice in trial.hypothesis.effects[first:]:
        columns = columns_of(trial, choice)
        for column, axis in zip(columns, effect_axes(choice), strict=True):
            if size[column] > SILENT * size.max() or len(columns) == 1 or is_essential(choice, axis.name):
                continue
            mine, held = _as_first(trial, choice, axis.name)
            hypothesis, point, place = pinned(mine, choice, held)
            value = axis.physical(float(trial.fit.point[column]))
            shown = axis.name not in MOMENTS or _is_shown(fitting, choice, value)
            same = _the_same(fitting, mine, hypothesis, point, _gone(mine, choice, held)) if shown else None
            fitted = [same] if same else path.fit(fitting, [(hypothesis, point)], search)
            if fitted and not judge.tells(fitted[0].squares, trial.squares):
                path.tried[hypothesis.effects[place]] = path.tried.pop(choice, [])
                return without_silent(fitting, judge, fitted[0], search, path, first)
    return trial


def _is_shown(fitting: Problem, choice: Choice, moment_s: float) -> bool:
    """Return whether a fitted run was recorded at a moment by the clock of ``choice``: only that shows that nothing happened."""
    clock = ("", *LASTING).index(choice.lasting)
    return any(run.gone_s[clock] <= moment_s <= run.gone_s[clock] + float(np.ptp(run.time)) for run in fitting.runs)


def _the_same(
    fitting: Problem, trial: Trial, hypothesis: Hypothesis, point: np.ndarray, gone: np.ndarray
) -> Trial | None:
    """Return ``trial`` as ``hypothesis`` at ``point`` (p,), if that predicts just the same without the parameters ``gone``.

    Else None. So it does without a run, then, however much estimates of that differ beside a law with a corner.
    """
    try:
        residual = fitting.residual(hypothesis, point, trial.placed).flat
    except SolverError:
        return None
    if np.linalg.norm(residual - trial.fit.residual) > SILENT * np.linalg.norm(residual):
        return None
    jacobian = np.delete(trial.fit.jacobian, gone, axis=1)
    return trial._replace(hypothesis=hypothesis, fit=trial.fit._replace(point=point, jacobian=jacobian))
