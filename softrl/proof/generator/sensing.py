"""What the sensors make of the motion: where they stand, how late they are, and their noise."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.proof.generator import laws
from softrl.proof.generator.plant import Motion


@dataclass(frozen=True)
class Noise:
    """Noise of the channels.

    Attributes
    ----------
    position_m, turn_rad, pressure_pa : standard deviation of one component
    colour : share of the variance that is coloured, 0..1
    memory_s : correlation time of the coloured part
    dropped, late : shares of samples that are lost, and whose stamp comes after the deed
    """

    position_m: float
    turn_rad: float
    pressure_pa: float
    colour: float
    memory_s: float
    dropped: float
    late: float


@dataclass(frozen=True)
class Sensed:
    """One session as recorded, and its clean truth at the same samples.

    Attributes
    ----------
    kept : (samples,) rows of the session that were not dropped
    time : (samples,) s
    position, quaternion : (samples, 3) m, (samples, 4) w x y z, with noise
    pressure : (samples, chambers) Pa, with noise
    clean : (samples, 3) m, what a sensor without noise would report at the stamped row
    """

    kept: np.ndarray
    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    pressure: np.ndarray
    clean: np.ndarray


def reported(table: np.ndarray, time: np.ndarray, motion: Motion, length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (position (steps, 3) m, orientation (steps, 3, 3)) after the sensor's own laws, without noise."""
    p, R = motion.position, motion.rotation
    p, R = _late(table, time, p, R)
    if table[laws.TWIST, 0] != 0.0:
        stretched = np.linalg.norm(p, axis=1) / length_m - 1.0
        bent = np.arccos(np.clip(R[:, 2, 2], -1.0, 1.0))
        turn = Rotation.from_rotvec(np.outer(table[laws.TWIST, 0] * (bent + 2.0 * stretched), [0.0, 0.0, 1.0]))
        p, R = turn.apply(p), turn.as_matrix() @ R
    if np.any(table[laws.MARKER, :3]):
        p = p + length_m * (R @ table[laws.MARKER, :3])
    if np.any(table[laws.FRAME, :5]):
        p, R = _turned(p, R, table[laws.FRAME, :3], length_m * np.r_[table[laws.FRAME, 3:5], 0.0])
    if table[laws.JOLT, 0] != 0.0:
        moved, R2 = _turned(p, R, table[laws.JOLT, 0] * table[laws.JOLT, 1:4], np.zeros(3))
        after = time > table[laws.JOLT, 4]
        p, R = np.where(after[:, None], moved, p), np.where(after[:, None, None], R2, R)
    return p, R


def sensed(
    table: np.ndarray, time: np.ndarray, motion: Motion, length_m: float, noise: Noise, rng: np.random.Generator
) -> Sensed:
    """Return what is recorded of a motion: noise, lost and late samples, rounding."""
    p, R = reported(table, time, motion, length_m)
    steps = len(time)
    kept = np.flatnonzero((rng.uniform(size=steps) >= noise.dropped) | (np.arange(steps) == 0))
    stamps = time + np.where(rng.uniform(size=steps) < noise.late, rng.uniform(0.002, 0.008, steps), 0.0)
    stamps = np.maximum.accumulate(stamps + 1e-6 * np.arange(steps))
    noisy = p + noise.position_m * _coloured((steps, 3), noise, rng)
    turn = Rotation.from_rotvec(noise.turn_rad * _coloured((steps, 3), noise, rng))
    quaternion = (turn * Rotation.from_matrix(R)).as_quat(scalar_first=True)
    quaternion *= np.where(quaternion[:, :1] < 0.0, -1.0, 1.0)
    pressure = motion.pressure + noise.pressure_pa * rng.standard_normal(motion.pressure.shape)
    return Sensed(
        kept,
        stamps[kept],
        np.round(noisy[kept], 5),
        quaternion[kept],
        25.0 * np.round(pressure[kept] / 25.0),
        p[kept],
    )


def _late(table: np.ndarray, time: np.ndarray, p: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = time.copy()
    if table[laws.SAMPLING, 0] > 0.0:
        period = table[laws.SAMPLING, 0]
        seen = time[0] + period * np.floor((seen - time[0]) / period + 1e-9)
    if table[laws.LATENCY, 0] > 0.0:
        seen = seen - table[laws.LATENCY, 0]
    if np.array_equal(seen, time):
        return p, R
    seen = np.clip(seen, time[0], time[-1])
    flat = np.hstack([p, R.reshape(len(R), 9)])
    mixed = np.stack([np.interp(seen, time, column) for column in flat.T], axis=1)
    turned = Rotation.from_matrix(mixed[:, 3:].reshape(-1, 3, 3))
    return mixed[:, :3], turned.as_matrix()


def _turned(p: np.ndarray, R: np.ndarray, turn: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rotation = Rotation.from_rotvec(turn)
    return rotation.apply(p) + shift, rotation.as_matrix() @ R


def _coloured(shape: tuple[int, int], noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance, white and first-order coloured parts together."""
    kept = np.exp(-0.02 / noise.memory_s)
    drawn, slow = rng.standard_normal(shape), np.empty(shape)
    slow[0] = rng.standard_normal(shape[1])
    for k in range(1, shape[0]):
        slow[k] = kept * slow[k - 1] + np.sqrt(1.0 - kept**2) * drawn[k]
    return np.asarray(np.sqrt(noise.colour) * slow + np.sqrt(1.0 - noise.colour) * rng.standard_normal(shape))
