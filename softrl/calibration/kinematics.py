"""Arc length, curvature and orientation of a constant-curvature backbone from the pose of its tip.

The backbone leaves the origin of the base frame along the robot's axis and is a circular arc to the tip:
with the chord c = |p| and the distance rho of the tip from the axis, kappa = 2 rho / c^2 and
l = c (theta / 2) / sin(theta / 2), theta = 2 atan2(rho, height).
"""

import numpy as np

from softrl.recordings.frame import axis_vector


def arc(position: np.ndarray, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """Return arc length (...,) m and curvature (...,) 1/m, never negative, of the arc to ``position`` (..., 3) m."""
    along = axis_vector(axis)
    height = position @ along
    offset = np.linalg.norm(position - height[..., None] * along, axis=-1)
    chord = np.linalg.norm(position, axis=-1)
    half = np.arctan2(offset, height)
    return chord / np.sinc(half / np.pi), 2.0 * offset / chord**2


def rotation_vector(quaternion: np.ndarray) -> np.ndarray:
    """Return rotation vectors (..., 3) rad of unit quaternions (..., 4) w x y z, of angle at most pi."""
    unit = quaternion * np.where(quaternion[..., :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(unit[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, unit[..., :1])
    return unit[..., 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)


def continued(turn: np.ndarray) -> np.ndarray:
    """Return rotation vectors (..., steps, 3) rad that go on from each other, where those of ``turn`` end at half a turn.

    A tip that bends on past pi would else turn back at once by two of them.
    """
    found = np.array(turn, dtype=float)
    for k in range(1, found.shape[-2]):
        now, before = found[..., k, :], found[..., k - 1, :]
        size = np.linalg.norm(now, axis=-1, keepdims=True)
        axis = now / np.maximum(size, 1e-12)
        around = np.round((np.sum(axis * before, axis=-1, keepdims=True) - size) / (2.0 * np.pi))
        found[..., k, :] = now + 2.0 * np.pi * around * axis
    return found


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle (...,) rad that turns one orientation (..., 4) w x y z into the other."""
    cosine = np.abs(np.sum(first * second, axis=-1))
    cosine /= np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return 2.0 * np.arccos(np.minimum(cosine, 1.0))
