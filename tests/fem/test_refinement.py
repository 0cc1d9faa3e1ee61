"""Further equilibria stand where the response is hardest to foretell, spread, and are equilibria like the others."""

from dataclasses import replace

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots
from softrl.core.tracking import NullTracker
from softrl.fem.answers import Row
from softrl.fem.chain import SLOPE, Found
from softrl.fem.continuation import Cost
from softrl.fem.refinement import disagreement, where_they_disagree
from softrl.fem.stage import run
from tests.fem.bodies import box_robot
from tests.fem.test_stage import CONFIG

SCALE = np.array([2.0, 1.0, 1.0, 1.0])
GROWTH = 3.0


def response(load: np.ndarray) -> Row:
    """Return a sample of a body with one chamber whose tip rises with the exponential of the pressure."""
    steep = np.exp(GROWTH * load[0] / SCALE[0])
    compliance, bend = np.eye(4), np.zeros((4, 4, 4))
    compliance[3, 0], bend[0, 3, 0] = GROWTH / SCALE[0] * steep, (GROWTH / SCALE[0]) ** 2 * steep
    return {"coordinate": np.r_[load[:3], steep + load[3]], "compliance": compliance, SLOPE + "compliance": bend}


def samples_at(loads: np.ndarray) -> list[Found]:
    return [(k, response(load), Cost(0, 0, 0, 0.0, np.zeros(0))) for k, load in enumerate(loads)]


def test_it_goes_where_the_response_bends_most() -> None:
    rng = np.random.default_rng(0)
    loads, candidates = rng.random((40, 4)) * SCALE, rng.random((640, 4)) * SCALE
    samples = samples_at(loads)
    near, spread = disagreement(candidates, loads, samples, SCALE)
    assert near.shape == (640, 3)
    chosen = where_they_disagree(candidates, loads, samples, SCALE, 10)
    assert len(set(chosen)) == 10 and np.median(candidates[chosen, 0]) > 0.7 * SCALE[0]
    assert len({frozenset(near[row]) for row in chosen}) == 10
    missed = [abs(response(candidates[row])["coordinate"][3] - _nearest(samples[near[row, 0]], loads, candidates[row]))
              for row in range(640)]  # fmt: skip
    assert np.mean(np.array(missed)[chosen]) > 3.0 * np.mean(missed)
    assert np.corrcoef(missed, spread)[0, 1] > 0.5


def _nearest(sample: Found, loads: np.ndarray, load: np.ndarray) -> float:
    number, row, _ = sample
    ahead = load - loads[number]
    return float((row["coordinate"] + row["compliance"] @ ahead + 0.5 * ahead @ row[SLOPE + "compliance"][:, 3] @ ahead)[3])


def test_of_a_quadratic_response_all_know_everything() -> None:
    loads = np.random.default_rng(1).random((12, 4))
    rows: list[Found] = []
    for k, load in enumerate(loads):
        compliance, bend = np.eye(4), np.zeros((4, 4, 4))
        compliance[3, 0], bend[0, 3, 0] = load[0], 1.0
        row = {"coordinate": np.r_[load[:3], 0.5 * load[0] ** 2 + load[3]], "compliance": compliance, SLOPE + "compliance": bend}
        rows.append((k, row, Cost(0, 0, 0, 0.0, np.zeros(0))))
    assert disagreement(np.random.default_rng(2).random((50, 4)), loads, rows, np.ones(4))[1].max() < 1e-12


def test_the_stage_adds_equilibria_and_keeps_those_of_before(box: Mesh) -> None:
    plain, more = (run(replace(CONFIG, trajectories=0, refined=count), box_robot(2), box, tracker=NullTracker())
                   for count in (0, 2))  # fmt: skip
    assert len(more.loads) >= len(plain.loads) + 2 and _inside(more)
    np.testing.assert_array_equal(more.loads[: len(plain.loads)], plain.loads)
    np.testing.assert_array_equal(more.coordinate[: len(plain.loads)], plain.coordinate)


def _inside(snapshots: Snapshots) -> bool:
    robot, pressure = box_robot(2), snapshots.loads[:, :2]
    return bool(pressure.min() >= robot.pressure_min_pa and pressure.max() <= robot.pressure_max_pa)
