"""Closed-form kinematics of the chain of gaps, with the analytic Jacobian, compiled.

Frames: at plane k-1 go up to the hinges of gap k, turn by ``Rx(theta_x) Ry(theta_y)``, go up to plane k, slide by d along
the turned z. Joint coordinates are ordered (theta_x, theta_y, d) per gap, gaps from below: ``q`` (3 gaps,).
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.surrogate import Surrogate


class Chain(NamedTuple):
    """Rest lengths in m: ``below`` (gaps,) plane to hinges, ``above`` (gaps,) hinges to plane, ``tool`` last plane to tip."""

    below: np.ndarray
    above: np.ndarray
    tool: float


def chain_of(surrogate: Surrogate) -> Chain:
    """Return the rest lengths of a surrogate's chain."""
    return chain_from(surrogate.joint_height, surrogate.plane_height, surrogate.tip_height)


def chain_from(joint_height: np.ndarray, plane_height: np.ndarray, tip_height: float) -> Chain:
    """Return the rest lengths between heights (gaps,) m of hinges and planes, and the tip's."""
    joint_height, plane_height = np.asarray(joint_height, dtype=float), np.asarray(plane_height, dtype=float)
    below = joint_height - np.concatenate([[0.0], plane_height[:-1]])
    return Chain(below, plane_height - joint_height, float(tip_height - plane_height[-1]))


@nb.njit(cache=True)
def pose(q: np.ndarray, chain: Chain, tip: np.ndarray, rotation: np.ndarray, jacobian: np.ndarray) -> None:
    """Fill the tip (3,) m, its rotation (3, 3) and d tip / d q (3, 3 gaps) at joint coordinates ``q``."""
    gaps = len(chain.below)
    origin = np.zeros((gaps, 3))
    for i in range(3):
        tip[i] = 0.0
        for j in range(3):
            rotation[i, j] = 1.0 if i == j else 0.0
    for k in range(gaps):
        for i in range(3):
            tip[i] += chain.below[k] * rotation[i, 2]
            origin[k, i] = tip[i]
            jacobian[i, 3 * k] = rotation[i, 0]  # axis of theta_x, turned into a velocity below
        _turn(rotation, 1, 2, q[3 * k])
        for i in range(3):
            jacobian[i, 3 * k + 1] = rotation[i, 1]
        _turn(rotation, 2, 0, q[3 * k + 1])
        for i in range(3):
            jacobian[i, 3 * k + 2] = rotation[i, 2]
            tip[i] += (chain.above[k] + q[3 * k + 2]) * rotation[i, 2]
    for i in range(3):
        tip[i] += chain.tool * rotation[i, 2]
    for k in range(gaps):
        x, y, z = tip[0] - origin[k, 0], tip[1] - origin[k, 1], tip[2] - origin[k, 2]
        for j in (3 * k, 3 * k + 1):
            a, b, c = jacobian[0, j], jacobian[1, j], jacobian[2, j]
            jacobian[0, j], jacobian[1, j], jacobian[2, j] = b * z - c * y, c * x - a * z, a * y - b * x


@nb.njit(cache=True)
def _turn(rotation: np.ndarray, first: int, second: int, angle: float) -> None:
    """Turn two columns of ``rotation`` about the third, from ``first`` towards ``second``, by ``angle`` rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    for i in range(3):
        a, b = rotation[i, first], rotation[i, second]
        rotation[i, first], rotation[i, second] = cosine * a + sine * b, cosine * b - sine * a


@nb.njit(cache=True)
def quaternion_of(rotation: np.ndarray, quaternion: np.ndarray) -> None:
    """Fill ``quaternion`` (4,) w x y z of a rotation of less than half a turn."""
    w = 0.5 * np.sqrt(max(1.0 + rotation[0, 0] + rotation[1, 1] + rotation[2, 2], 1e-12))
    quaternion[0] = w
    quaternion[1] = (rotation[2, 1] - rotation[1, 2]) / (4.0 * w)
    quaternion[2] = (rotation[0, 2] - rotation[2, 0]) / (4.0 * w)
    quaternion[3] = (rotation[1, 0] - rotation[0, 1]) / (4.0 * w)


@nb.njit(cache=True)
def grouped_pose(
    theta: np.ndarray,
    chain: Chain,
    q: np.ndarray,
    tip: np.ndarray,
    rotation: np.ndarray,
    jacobian: np.ndarray,
    grouped: np.ndarray,
) -> None:
    """Fill the pose under the grouped command ``theta`` (3,) and d tip / d theta (3, 3) in ``grouped``."""
    gaps = len(chain.below)
    for k in range(gaps):
        for j in range(3):
            q[3 * k + j] = theta[j]
    pose(q, chain, tip, rotation, jacobian)
    for i in range(3):
        for j in range(3):
            grouped[i, j] = 0.0
            for k in range(gaps):
                grouped[i, j] += jacobian[i, 3 * k + j]


@nb.njit(cache=True)
def grouped_poses(theta: np.ndarray, chain: Chain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return tips (B, 3) m, quaternions (B, 4) w x y z and d tip / d theta (B, 3, 3) of grouped commands (B, 3)."""
    batch, joints = len(theta), 3 * len(chain.below)
    tips, quaternions, jacobians = np.empty((batch, 3)), np.empty((batch, 4)), np.empty((batch, 3, 3))
    q, rotation, jacobian = np.empty(joints), np.empty((3, 3)), np.empty((3, joints))
    for b in range(batch):
        grouped_pose(theta[b], chain, q, tips[b], rotation, jacobian, jacobians[b])
        quaternion_of(rotation, quaternions[b])
    return tips, quaternions, jacobians


@nb.njit(cache=True)
def joint_jacobians(theta: np.ndarray, chain: Chain) -> np.ndarray:
    """Return d tip / d q (B, 3, 3 gaps) of every single joint at grouped commands (B, 3)."""
    batch, joints = len(theta), 3 * len(chain.below)
    jacobians = np.empty((batch, 3, joints))
    q, tip, rotation, grouped = np.empty(joints), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for b in range(batch):
        grouped_pose(theta[b], chain, q, tip, rotation, jacobians[b], grouped)
    return jacobians


@nb.njit(cache=True)
def joint_axes(theta: np.ndarray, chain: Chain) -> tuple[np.ndarray, np.ndarray]:
    """Return d orientation / d q (B, 3, 3 gaps), the axis of every hinge, zero for slides, and the tip's axis (B, 3)."""
    batch, gaps = len(theta), len(chain.below)
    axes, tip = np.zeros((batch, 3, 3 * gaps)), np.empty((batch, 3))
    for b in range(batch):
        rotation = np.eye(3)
        for k in range(gaps):
            axes[b, :, 3 * k] = rotation[:, 0]
            _turn(rotation, 1, 2, theta[b, 0])
            axes[b, :, 3 * k + 1] = rotation[:, 1]
            _turn(rotation, 2, 0, theta[b, 1])
        tip[b] = rotation[:, 2]
    return axes, tip
