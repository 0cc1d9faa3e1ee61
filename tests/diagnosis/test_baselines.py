"""What needs no physics is no straw man: it learns what a lag does, and never does worse for knowing more."""

import numpy as np

from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.baselines import without_physics
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


def test_a_black_box_learns_what_a_static_map_cannot(body: PccSimulator) -> None:
    runs = made(body, (Lag(fill_s=0.3, vent_s=0.5),), sessions=3).recordings
    held = [run for run in runs if run.session == runs[-1].session]
    rest = tuple(run for run in runs if run not in held)
    problem = Problem(body.robot, body, rest, configured().numerics, "motion", "command", False, False)
    found = without_physics(problem, {"heldout": problem.on(tuple(held))}, {})["heldout"]
    motion = np.concatenate([np.asarray(run.position) for run in held])
    size = float(np.sqrt(np.mean(np.sum((motion - motion.mean(axis=0)) ** 2, axis=1))))
    static, box = (found[name].rms for name in ("static", "blackbox"))
    assert box < 0.2 * size < 0.5 * static, (box, static, size)
