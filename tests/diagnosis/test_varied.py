"""A turned frame is turned by as much in every pose: what turns with the bending is told from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.judging.leftover import heldout_residual, varies
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made

NOISE_M = 1e-4


@pytest.mark.parametrize(("by_bending", "varying"), [(0.0, False), (0.3, True)])
def test_a_turn_that_grows_with_the_bending_is_no_frames(body: PccSimulator, by_bending: float, varying: bool) -> None:
    def turned(run: Recording) -> Recording:
        assert run.position is not None and run.quaternion is not None
        bent = Rotation.from_quat(run.quaternion, scalar_first=True).magnitude()
        turn = Rotation.from_rotvec(np.outer(0.1 + by_bending * (bent - 0.2), [0.0, 0.0, 1.0]))
        return replace(run, position=turn.apply(run.position))

    runs, config = made(body, seed=4, noise_m=NOISE_M, process=turned).recordings, configured()
    problem = Problem(body.robot, body, runs[:4], config.numerics, "motion", "command", False, False)
    frame = Hypothesis((Choice("frame"),), problem.tuned)
    (trial,) = fit_trials(problem, None, [(frame, [])], config.search)
    samples = config.numerics.bin_s / 0.02
    travel = float(np.std(np.concatenate([np.asarray(run.position) for run in runs]), axis=0).max())
    judge = Judge(problem.on(runs[4:]), NOISE_M * (3.0 / samples) ** 0.5, travel, config.thresholds, 0)
    trial = trial._replace(squares=heldout_residual(judge, trial).squares)
    assert varies(problem, judge, trial) is varying
