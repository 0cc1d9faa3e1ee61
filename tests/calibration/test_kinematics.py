"""Arc length and curvature of a circular arc are found back; orientations by angle."""

import numpy as np

from softrl.calibration.kinematics import angle_between, arc, continued, rotation_vector


def tip_of_arc(length: float, curvature: float, direction: float) -> np.ndarray:
    angle = length * curvature
    offset = (1.0 - np.cos(angle)) / curvature
    return np.array([offset * np.cos(direction), offset * np.sin(direction), np.sin(angle) / curvature])


def test_arc_inverts_the_tip_of_an_arc() -> None:
    for length, curvature, direction in ((0.18, 1e-6, 0.3), (0.2, 3.0, 1.0), (0.15, 12.0, -2.0)):
        found = arc(tip_of_arc(length, curvature, direction), "+z")
        np.testing.assert_allclose(found, (length, curvature), rtol=1e-6, atol=1e-9)


def test_straight_tip_has_its_own_length_and_no_curvature() -> None:
    np.testing.assert_allclose(arc(np.array([0.0, -0.2, 0.0]), "-y"), (0.2, 0.0))


def test_rotation_vector_and_angle_agree_and_ignore_the_sign_of_the_quaternion() -> None:
    axis, angle = np.array([0.6, 0.0, 0.8]), 0.4
    quaternion = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
    np.testing.assert_allclose(rotation_vector(quaternion), angle * axis, atol=1e-12)
    np.testing.assert_allclose(rotation_vector(-quaternion), angle * axis, atol=1e-12)
    np.testing.assert_allclose(rotation_vector(np.array([1.0, 0.0, 0.0, 0.0])), np.zeros(3))
    assert abs(angle_between(-quaternion, np.array([1.0, 0.0, 0.0, 0.0])) - angle) < 1e-7


def test_rotation_vectors_go_on_beyond_half_a_turn_and_a_whole_one() -> None:
    axis, angle = np.array([0.6, 0.0, -0.8]), np.array([np.linspace(0.0, 8.0, 90), np.linspace(3.0, -4.0, 90)])
    quaternion = np.concatenate([np.cos(angle / 2)[..., None], np.sin(angle / 2)[..., None] * axis], axis=-1)
    quaternion *= np.where(np.arange(90) % 7 == 0, -1.0, 1.0)[:, None]
    np.testing.assert_allclose(continued(rotation_vector(quaternion)), angle[..., None] * axis, atol=1e-12)
