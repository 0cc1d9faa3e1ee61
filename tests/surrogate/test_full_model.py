"""Laws of stiffness: tangents are what small loads do, PyBullet yields as the chain says, and the chain as the full model."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.fem.model import FemModel
from softrl.surrogate.full_model import Yielding, bullet_yielding, full_yielding, stiffness_errors
from softrl.surrogate.kinematics import chain_of, joint_axes, joint_jacobians
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.springs import Springs, springs_of, stiffness_matrix
from softrl.surrogate.stiffness import Compliance, Couple, chain_turn, fit_springs, turn_between
from softrl.surrogate.twin import chain_compliance
from tests.fem.bodies import bar, box_robot, model_of
from tests.surrogate.conftest import SOFTNESS_M_PER_N
from tests.surrogate.test_twin import bent_springs

SIDE_M, LENGTH_M, YOUNG_PA = 0.01, 0.1, 1e6


@pytest.fixture(scope="module")
def beam() -> FemModel:
    """Return a slender bar, which bends as every book says."""
    return model_of(bar((2, 2, 12), (SIDE_M, SIDE_M, LENGTH_M)))


def test_a_slender_bar_yields_as_a_beam(beam: FemModel) -> None:
    found = full_yielding(beam, box_robot(1), np.zeros((1, 1))).yields[0]
    bending, length = YOUNG_PA * SIDE_M**4 / 12.0, LENGTH_M
    np.testing.assert_allclose(np.diag(found)[:2], length**3 / (3.0 * bending), rtol=0.05)
    np.testing.assert_allclose(np.diag(found)[3:5], length / bending, rtol=0.05)
    np.testing.assert_allclose(found[4, 0], length**2 / (2.0 * bending), rtol=0.05)
    np.testing.assert_allclose(found, found.T, atol=1e-6 * np.abs(found).max())


def test_tangents_are_what_small_forces_do(beam: FemModel) -> None:
    found, force = full_yielding(beam, box_robot(1), np.zeros((1, 1))).yields[0], 1e-3
    for axis in range(3):
        ahead, behind = (beam.static(np.r_[0.0, sign * force * np.eye(3)[axis]]).pose for sign in (1.0, -1.0))
        moved = (beam.tip(ahead) - beam.tip(behind)) / (2.0 * force)
        turned = turn_between(beam.tip_quaternion(behind)[None], beam.tip_quaternion(ahead)[None])[0] / (2.0 * force)
        np.testing.assert_allclose(found[:, axis], np.r_[moved, turned], atol=2e-3 * np.abs(found[:, axis]).max())


def chain_yields(theta: np.ndarray, surrogate: Surrogate) -> np.ndarray:
    """Return d (tip, turn) / d (force, moment) (6, 6) of the chain's joints at a command (3,), in closed form."""
    rows, chain = np.ascontiguousarray(theta[None]), chain_of(surrogate)
    slopes = np.vstack([joint_jacobians(rows, chain)[0], joint_axes(rows, chain)[0][0]])
    return slopes @ np.linalg.solve(stiffness_matrix(theta, springs_of(surrogate)), slopes.T)


def test_pybullet_yields_to_forces_and_moments_as_the_joints_say(surrogate: Surrogate) -> None:
    pressure = surrogate.sample_pressure[:2]
    found = bullet_yielding(surrogate, pressure, 2.0).yields
    for row, theta in zip(found, PressureToJoints(surrogate).joints(pressure), strict=True):
        expected = chain_yields(theta, surrogate)
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(row[:, :5] / size[:, :5], expected[:, :5] / size[:, :5], atol=0.01)


def test_moments_tell_how_the_give_is_spread(surrogate: Surrogate) -> None:
    chain, theta = chain_of(surrogate), np.ascontiguousarray(surrogate.sample_joints[:40])
    truth = bent_springs(surrogate, 0.4)
    # two gaps of six make up the give: no taper of slope and bow is like it
    truth = truth._replace(share=np.array([2.2, 0.7, 0.35, 0.35, 0.6, 1.8]))
    body = Compliance(chain_compliance(theta, chain, truth), chain_turn(theta, chain, truth))

    def turn_of(springs: Springs) -> np.ndarray:
        changed = replace(surrogate, softness_coefficients=springs.coefficients, gap_share=springs.share)
        return chain_yields(theta[0], changed)[3:, 3:]

    fit = partial(fit_springs, theta, chain, body, truth.low, truth.high, 300, 1e-9)
    off = {
        told: np.abs(turn_of(fit(couple=Couple(theta[0], turn_of(truth)) if told else None)) / turn_of(truth) - 1.0)[0, 0]
        for told in (False, True)
    }
    assert off[True] < 0.01, off


def errors_at_rest(surrogate: Surrogate, full: Yielding) -> dict[str, float]:
    theta = np.ascontiguousarray(PressureToJoints(surrogate).joints(full.pressure))
    found = stiffness_errors(bullet_yielding(surrogate, full.pressure, 2.0), full, joint_axes(theta, chain_of(surrogate))[1])
    return {name: float(error[0]) for name, error in found.items()}


def test_one_that_yields_as_the_other_does_not_differ(surrogate: Surrogate) -> None:
    found = errors_at_rest(surrogate, bullet_yielding(surrogate, np.zeros((1, surrogate.chambers)), 2.0))
    assert max(map(abs, found.values())) < 1e-6


def test_the_tip_is_as_stiff_in_pybullet_as_the_body_within_5_percent(surrogate: Surrogate) -> None:
    pressure = np.vstack([np.zeros((1, surrogate.chambers)), surrogate.sample_pressure[surrogate.heldout][:3]])
    found = np.einsum("sii->si", bullet_yielding(surrogate, pressure, 2.0).yields[:, :3, :3])
    np.testing.assert_allclose(1.0 / found, np.tile(1.0 / SOFTNESS_M_PER_N, (len(pressure), 1)), rtol=0.05)
