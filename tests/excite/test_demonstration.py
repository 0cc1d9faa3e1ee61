"""What planning is for: small effects under a noisy camera, recorded on the planned program."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis import stage as diagnosis
from softrl.effects.chain import chain_of
from softrl.excite import stage as excite
from softrl.excite.rival import parse
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from softrl.simulate import stage as simulate

CONF = Path(__file__).parents[2] / "conf"
MINUTES, RUNS = 1.25, 2
LIBRARY = [
    "lag", "dead_time", "hysteresis", "friction", "viscoelasticity", "mullins", "drift", "offset", "gain", "crosstalk",
]  # fmt: skip
QUICK = {"max_effects": 1, "keep": 3, "starts": 1, "iterations": 8, "rivals": 2, "fit_lumped_s": 80.0, "workers": 1}


def node(path: str, **changed: Any) -> Any:
    data = {k: v for k, v in yaml.safe_load((CONF / path).read_text()).items() if k != "_target_"}
    return OmegaConf.to_container(OmegaConf.merge(data, changed))


ROBOT = build(node("robot/tripod.yaml"), Robot, "robot")
NOMINAL = PccSimulator(robot=ROBOT, **node("simulator/pcc.yaml"))
ACTUAL = NOMINAL.with_parameters(bending_stiffness_scale=1.08, damping_s=0.045, mass_scale=0.95)


def recorded(time: np.ndarray, programs: np.ndarray, truth: str, size: float) -> RecordingSet:
    """Return ``programs`` (runs, steps, chambers) as a robot with the hidden effect answers them."""
    given = RecordingSet(
        ROBOT.name, tuple(Recording(f"run_{k}", f"day_{k}", time, rows) for k, rows in enumerate(programs))
    )
    settings = node(
        "stage/simulate.yaml", seed=5, out=None, position_noise_m=5e-4, position_colour_m=2e-4, colour_s=0.5,
        orientation=False, measured_pressure=False,
    )  # fmt: skip
    config = build(settings, simulate.Config, "stage")
    chain = chain_of(ROBOT, parse(truth, ROBOT, size))
    return simulate.run(config, ROBOT, ACTUAL, chain, given, tracker=NullTracker())


def diagnosed(recordings: RecordingSet) -> Diagnosis:
    settings = node("stage/diagnosis.yaml", seed=0, candidates=LIBRARY, search=QUICK, thresholds={"draws": 300})
    return diagnosis.run(build(settings, diagnosis.Config, "stage"), ROBOT, recordings, NOMINAL, tracker=NullTracker())


def names(found: Diagnosis) -> list[str]:
    """Return what was named; an effect in one chamber with its number, as in a list of hypotheses."""
    return [e["name"] + ("" if e["chamber"] < 0 else f"@{e['chamber'] + 1}") for e in found.effects]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "rival", "size"),
    [
        ("lag", "dead_time", 0.2), ("dead_time", "lag", 0.4), ("mullins", "drift", 0.1), ("drift", "mullins", 0.1),
        ("friction", "hysteresis", 0.14), ("hysteresis", "friction", 0.1), ("viscoelasticity", "hysteresis", 0.1),
        ("crosstalk@1", "gain@1", 0.1),
    ],
)  # fmt: skip
def test_a_planned_program_tells_a_hard_pair_apart(truth: str, rival: str, size: float) -> None:
    """At a tenth of the typical strength, more where nearest; what comes late, by more than a log's row may act late, 20 ms."""
    seed = 0
    settings = node("stage/excite.yaml", hypotheses=[truth, rival], minutes=MINUTES, size=size, runs=RUNS,
                    seed=seed, out=None, sensing={"position_mm": 0.5})  # fmt: skip
    planned = excite.run(build(settings, excite.Config, "stage"), ROBOT, NOMINAL, None, tracker=NullTracker())
    apart = planned.pairs[0]["separation_sigma"]
    assert apart["planned"] > 1.3 * apart["default"], apart
    found = diagnosed(recorded(planned.time, np.stack([planned.pressure] * RUNS), truth, size))
    assert found.verdict == "named" and names(found) == [truth], found.sentences
    assert found.errors_mm["heldout"]["corrected"] < found.errors_mm["heldout"]["retuned"]
