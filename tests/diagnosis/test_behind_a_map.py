"""What begins midway behind a calibration map is found, although neither explains anything without the other."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.hypothesise import _behind_a_map
from softrl.diagnosis.search.path import Path
from softrl.effects.effect import Effect
from softrl.effects.gain import Gain
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made

MIX = np.array([[1.1, 0.05, 0.0], [-0.04, 0.92, 0.03], [0.0, 0.06, 1.04]])


def mapped(run: Recording) -> Recording:
    return replace(run, pressure_cmd=run.pressure_cmd @ MIX.T)


@pytest.mark.parametrize(
    ("hidden", "names"), [((Gain(1.2, chamber=1, since_s=14.0),), ("command_map", "gain")), ((), ())]
)
def test_a_late_gain_is_found_together_with_the_map(
    body: PccSimulator, hidden: tuple[Effect, ...], names: tuple[str, ...]
) -> None:
    config = configured(numerics={"dt_s": 0.02, "rough_dt_s": 0.04})
    runs = made(body, hidden, process=mapped if hidden else None, sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    travel = float(np.mean([run.position.std(axis=0).max() for run in runs if run.position is not None]))
    judge = Judge(problem, 1e-4 * np.sqrt(3.0 / 5.0), travel, config.thresholds, 0)
    tuned = tuple(body.parameters)
    retuned = fit_trials(problem, None, [(Hypothesis((), tuned), [np.zeros(len(tuned))])], config.search)[0]
    path = Path(retuned, retuned)
    choices = [Choice("command_map"), Choice("gain"), Choice("gain", 0), Choice("gain", 1)]
    assert _behind_a_map(problem, judge, choices, config.search, path, lambda line: None) == bool(hidden)
    assert path.best.hypothesis.names == names
    if hidden:
        found = path.best.hypothesis.effects[1]
        assert (found.chamber, found.gate and found.gate.field) == (1, "since_s")
