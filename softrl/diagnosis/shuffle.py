"""The negative control: recordings whose mismatch has its spectrum but not its cause. Nothing may be found in them."""

from dataclasses import replace

import numpy as np

from softrl.core.errors import RecordingError
from softrl.core.simulator import Simulator
from softrl.diagnosis.correct import Model, seen, traces
from softrl.diagnosis.hypothesis import Hypothesis
from softrl.diagnosis.hypothesise import Search, fit_trials
from softrl.diagnosis.problem import Numerics, Problem
from softrl.diagnosis.statistics import phase_randomised
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot


def shuffled(
    recordings: RecordingSet, robot: Robot, simulator: Simulator, numerics: Numerics, search: Search, seed: int
) -> RecordingSet:
    """Return recordings that equal the retuned simulator plus its own residuals with random phases.

    A diagnosis of them must name no effect and locate nothing: what is left has the spectrum of the mismatch, and no
    relation to the pressures. Orientations and measured pressures are left out, since their mismatch is not shuffled.
    """
    runs = tuple(replace(run, quaternion=None, pressure_meas=None, markers={}) for run in recordings.recordings)
    if not runs:
        raise RecordingError("no recordings to shuffle")
    problem = Problem(robot, simulator, runs, numerics, "motion", "command", False, False)
    hypothesis = Hypothesis((), tuple(simulator.parameters))
    fit = fit_trials(problem, None, [(hypothesis, [])], search)[0].fit
    predicted = traces(problem, Model(hypothesis, fit.point, {})).predicted
    rng = np.random.default_rng(seed)
    made = []
    for run, motion in zip(runs, predicted, strict=True):
        made.append(_moved(run, motion + phase_randomised(seen(problem, run) - motion, rng), problem))
    return replace(recordings, recordings=tuple(made))


def _moved(run: Recording, motion: np.ndarray, problem: Problem) -> Recording:
    if problem.robot.output == "bend_angle":
        return replace(run, bend_angle=motion[:, 0])
    return replace(run, position=motion)
