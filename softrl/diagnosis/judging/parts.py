"""The parts of the pipeline that are examined apart: the valve and the body behind it, or both at once."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softrl.core.simulator import Layered
from softrl.diagnosis.checks.data import Data
from softrl.diagnosis.checks.prelude import preludes
from softrl.diagnosis.checks.within import within
from softrl.diagnosis.fitting.choices import candidates, in_some_sessions, that_last
from softrl.diagnosis.fitting.hypothesis import LATE, Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import ORIENTATION_LEVER, Problem
from softrl.diagnosis.fitting.trial import Trial, columns_of
from softrl.diagnosis.judging.examine import Finding, Named, Part
from softrl.diagnosis.series.blocks import correlation_time
from softrl.effects.chain import chain_of
from softrl.effects.driving import Supply
from softrl.effects.effect import SITES
from softrl.recordings.gone import sessions_in_order
from softrl.recordings.recording import Recording

BEHIND_GAUGES = "measured pressure to motion"
PLACED = ("frame", "base_tilt")  # no news where every session is placed by itself
SURE = 3.0  # standard errors that a sensor's bias must exceed
EARLIER = (0.0, 0.25, 0.5, 0.75)  # shares of how late a log was found to be, of which the least that does as well is taken
VALVE_S = 1200.0  # of the recordings, which a valve's fits see at most
VALVE_STEPS = 4  # of a valve to one of the body: it costs little, and pressures are measured well


def both_at_once(whole: Problem, data: Data, effects: list[str]) -> Part:
    """Return the pipeline from command to motion."""
    return _motion_part(whole, data, "command to motion", effects, SITES)


def valve_part(whole: Problem, data: Data, effects: list[str], gauges: Sequence[Choice] = ()) -> Part:
    """Return the pipeline from command to measured pressure, in finer steps; errors of ``gauges`` are considered, too."""
    steps = whole.numerics
    finer = replace(steps, dt_s=steps.dt_s / VALVE_STEPS, rough_dt_s=steps.rough_dt_s / VALVE_STEPS)
    runs = within(data.training, VALVE_S)
    problem = replace(whole, target="pressure", register=False, orientation=False, runs=runs, numerics=finer)
    sessions, excited = [[run.session for run in side] for side in (runs, data.heldout)], data.check.excited
    everywhere = candidates(effects, ("valve",), whole.robot, excited, gauges_only=True)
    order = sessions_in_order((*data.training, *data.heldout))
    choices = in_some_sessions(effects, *sessions, order, excited, gauges_only=True) + everywhere
    choices += [*that_last(everywhere, *sessions), *gauges]
    return Part(
        "command to measured pressure", problem, data.heldout, data.pressure_noise, data.pressure_rounding,
        data.pressure_travel, tuple(choices), data.now,
    )  # fmt: skip


def punctual(valve: Finding) -> Finding:
    """Return the finding with a log, or a dead time, that is no later than the pressures tell.

    Where a regulator is quicker than the log, its pressure is the same at every sample however late the rows act in between;
    the body behind it tells.
    """
    final = _earliest(valve.judge, valve.final)
    named = [_told_at(valve.part.problem, final, effect) if effect.choice.shifts_time else effect for effect in valve.named]
    return replace(valve, base=_earliest(valve.judge, valve.base), final=final, named=named)


def _earliest(judge: Judge, trial: Trial) -> Trial:
    for share in EARLIER:
        sooner = _sooner(judge.problem, trial, share)
        if np.array_equal(sooner, trial.fit.point):
            break
        squares = judge.problem.residual(trial.hypothesis, sooner, trial.placed).squares
        if not judge.tells(squares, trial.squares):
            return trial._replace(fit=trial.fit._replace(point=sooner), squares=squares)
    return trial


def _sooner(problem: Problem, trial: Trial, share: float) -> np.ndarray:
    """Return the point of ``trial`` with ``share`` of how late its log is, and dead times as much of a row shorter."""
    point, axes = trial.fit.point.copy(), problem.space(trial.hypothesis).axes
    if LATE in trial.hypothesis.tuned:
        point[-1] *= share
    for choice in trial.hypothesis.effects:
        if choice.shifts_time:
            delay = columns_of(trial, choice)[0]
            wanted = axes[delay].physical(point[delay]) - (1.0 - share) * problem.late_max_s
            point[delay] = axes[delay].scaled(max(wanted, axes[delay].low))
    return point


def _told_at(problem: Problem, trial: Trial, effect: Named) -> Named:
    """Return a named effect with the parameters of ``trial``, its intervals wide enough to hold them."""
    values = problem.space(trial.hypothesis).values(trial.fit.point)
    told = [
        known._replace(value=values[k], low=min(known.low, values[k]), high=max(known.high, values[k]))
        for k, known in zip(columns_of(trial, effect.choice), effect.intervals, strict=True)
    ]
    return effect._replace(intervals=told)


def part_behind(valve: Finding, whole: Problem, data: Data, effects: list[str]) -> Part:
    """Return the pipeline from measured pressure to motion.

    A command that is no pressure, or a valve that is not understood, says nothing about a sensor's zero and noise, nor about
    what happens between its samples.
    """
    body, supply = data, {}
    if whole.robot.command == "pressure" and not valve.unknown:
        known = [_understood(runs, valve, data.pressure_noise) for runs in (whole.runs, data.heldout)]
        training, heldout = (tuple(run for run, _ in side) for side in known)
        body = replace(data, training=training, heldout=heldout)
        supply = {run.name: found for side in known for run, found in side}
    before = preludes(body.training, body.used, whole.robot, one_frame=not whole.register)
    later = valve.part.problem.later
    behind = replace(whole, drive="measured", runs=body.training, before=before, supply=supply, later=later)
    sites = tuple(site for site in SITES if site != "valve")
    return _motion_part(behind, body, BEHIND_GAUGES, effects, sites)


def _motion_part(problem: Problem, data: Data, title: str, effects: list[str], sites: tuple[str, ...]) -> Part:
    wanted = [name for name in effects if not (problem.register and name in PLACED)]
    sessions = [[run.session for run in side] for side in (data.training, data.heldout)]
    layers = isinstance(problem.simulator, Layered)
    everywhere = candidates(wanted, sites, problem.robot, data.check.excited, layers, data.varied)
    order = sessions_in_order((*data.training, *data.heldout))
    choices = in_some_sessions(wanted, *sessions, order, data.check.excited) + everywhere + that_last(everywhere, *sessions)
    turned = ORIENTATION_LEVER * problem.robot.length_m * data.turn_noise if problem.orientation else 0.0
    noise = float(np.hypot(data.noise, turned))
    return Part(
        title, problem.on(data.training), data.heldout, noise, data.rounding, data.travel, tuple(choices), data.now
    )


def supplied(runs: Sequence[Recording], valve: Finding, shown: bool = True) -> list[Recording]:
    """Return what the valve as it is understood makes of the commands of ``runs``: as its gauges have ``shown`` it, or itself."""
    final, problem = valve.final, valve.part.problem.on(runs)
    gauges = [choice for choice in final.hypothesis.effects if choice.site == "sensor" and not shown]
    point = np.delete(final.fit.point, [column for choice in gauges for column in columns_of(final, choice)])
    others = tuple(choice for choice in final.hypothesis.effects if choice not in gauges)
    return problem.replayed(Hypothesis(others, final.hypothesis.tuned), point, ("pressure_meas",))


def _understood(runs: Sequence[Recording], valve: Finding, noise: float) -> list[tuple[Recording, Supply]]:
    """Return the runs with pressures as far as the valve explains them, or their difference from that is no ``noise``, Pa.

    A body that is driven by a sensor's noise shakes. What is kept of a difference is the share of its mean square that noise
    leaves, as in Wiener's filter of a signal that is as white. Beside each run stands the valve, for what it does between
    samples.
    """
    final, problem = valve.final, valve.part.problem.on(runs)
    space, point, found = problem.space(final.hypothesis), final.fit.point, []
    for run, made, to in zip(runs, supplied(runs, valve), supplied(runs, valve, shown=False), strict=True):
        chain = chain_of(problem.robot, space.effects(point, run.session, run.gone_s))
        apart = run.pressure_meas - made.pressure_meas
        apart -= bias(apart)
        square = float(np.mean(np.sum(apart**2, axis=1)))
        apart *= max(1.0 - noise**2 / square, 0.0) if square > 0.0 else 0.0
        mended = replace(run, pressure_meas=to.pressure_meas + apart)
        found.append((mended, Supply(chain, problem.late_in(run, space.late(point)), apart)))
    return found


def bias(differences: np.ndarray) -> np.ndarray:
    """Return the constant part (chambers,) Pa of ``differences`` (samples, chambers), as far as it is one for sure.

    What a valve's law does not quite get right has a mean of its own, which is no bias of the sensor.
    """
    mean, chambers = differences.mean(axis=0), differences.shape[1]
    alike = np.array([correlation_time(differences[:, k]) for k in range(chambers)])
    doubt = differences.var(axis=0) * alike / len(differences)
    return np.asarray(mean * np.maximum(1.0 - SURE**2 * doubt / np.maximum(mean**2, 1e-300), 0.0))
