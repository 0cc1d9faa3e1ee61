"""Symmetries of chamber layouts, and that they leave a symmetric body's energy alone."""

import numpy as np
import pytest

from softrl.pod.fitting.equilibria import equilibria, rotation_vector
from softrl.pod.fitting.symmetry import reflected, weight_to_trust
from softrl.robots.symmetry import symmetries
from tests.pod.synthetic import law_of, quaternion, robot_with, synthetic_snapshots


@pytest.mark.parametrize("chambers", [1, 2, 3, 4])
def test_regular_layouts_have_as_many_turns_and_mirrors_as_chambers(chambers: int) -> None:
    found = symmetries(robot_with(chambers).chamber_direction)
    assert len(found) == 2 * chambers
    np.testing.assert_allclose(found[0].coordinate, np.eye(chambers + 3), atol=1e-12)


def test_an_uneven_layout_keeps_only_its_mirror() -> None:
    angle = np.deg2rad([90.0, 200.0, 340.0])
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert len(symmetries(direction)) == 2


def test_chambers_at_one_angle_have_the_identity_alone() -> None:
    """An arm of two segments has its chambers one above the other."""
    two_segments = np.tile(robot_with(3).chamber_direction, (2, 1))
    (found,) = symmetries(two_segments)
    np.testing.assert_array_equal(found.coordinate, np.eye(9))


@pytest.mark.parametrize("chambers", [1, 2, 3])
def test_images_are_equilibria_of_the_same_body(chambers: int) -> None:
    robot = robot_with(chambers)
    law, samples = law_of(robot), equilibria(synthetic_snapshots(robot, 3, seed=4, trajectories=0))
    images = reflected(samples, symmetries(robot.chamber_direction))
    for load, z, energy, compliance, centre, turn in zip(
        images.load,
        images.coordinate,
        images.energy,
        images.compliance,
        images.answers["moments"][:, 0] / images.moment_gram[0, 0],
        images.answers["rotation"],
        strict=True,
    ):
        np.testing.assert_allclose(law.gradient(z), load, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(law.energy(z), energy, rtol=1e-9)
        np.testing.assert_allclose(law.hessian(z) @ compliance, np.eye(len(z)), atol=1e-6)
        np.testing.assert_allclose(law.centre_of_mass(z), centre, atol=1e-12)
        np.testing.assert_allclose(law.rotation(z), turn, atol=1e-12)


def test_answers_of_images_change_as_those_of_the_same_body() -> None:
    robot = robot_with(3)
    law, samples = law_of(robot), equilibria(synthetic_snapshots(robot, 3, seed=4, trajectories=0))
    images = reflected(samples, symmetries(robot.chamber_direction))
    mass = np.array([law.mass(z) for z in images.coordinate])
    np.testing.assert_allclose(images.answers["mass"], mass, atol=1e-9 * np.abs(mass).max())
    slopes = np.array([law.slopes_of(law.mass, z) for z in images.coordinate])
    unit, load = 1.0 / np.sqrt(np.diag(mass[0])), np.abs(images.load).max(axis=0)[:, None, None]
    error = np.abs(images.slopes["mass"] - slopes) * load * unit * unit[:, None]
    assert error.max() < 1e-5 < 1e-2 < (np.abs(slopes) * load * unit * unit[:, None]).max()


def test_rotation_vectors_invert_quaternions() -> None:
    turns = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3))
    found = rotation_vector(np.array([quaternion(turn) * sign for turn, sign in zip(turns, [1, -1] * 10, strict=True)]))
    np.testing.assert_allclose(found, turns, atol=1e-12)


def test_images_count_in_full_unless_the_body_is_lopsided() -> None:
    assert weight_to_trust({0.003: 0.07, 0.1: 0.08, 1.0: 0.09}) == 1.0
    assert weight_to_trust({0.003: 0.16, 0.1: 0.36, 1.0: 0.56}) == 0.003
    assert weight_to_trust({1.0: 0.2}) == 1.0
