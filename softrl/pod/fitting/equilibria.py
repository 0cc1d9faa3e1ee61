"""What a fit reads of the snapshots: equilibria with their answers, and how these change along the equilibria."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrl.artifacts.snapshots import Snapshots

STEP = 1e-4  # of the largest load, for differences: they are of second order
Answers = dict[str, np.ndarray]

# the axes of each answer after that of the samples: w as a load or coordinate, v a vector, i two of them, s a spin, m a moment,
# l a layer
AXES = {
    "compliance": "ww",
    "stiffness": "ww",
    "mass": "ww",
    "moments": "mv",
    "give": "vv",
    "give_spin": "sv",
    "inner_give": "ii",
    "inner_spin": "si",
    "inner_mass": "ii",
    "inner_coupling": "iw",
    "inner_viscosity": "ii",
    "inner_drag": "iw",
    "rotation": "s",
    "viscosity_by_gravity": "vww",
    "layer_energy": "l",
    "layer_give": "ll",
    "layer_drop": "vl",
    "layer_spin": "sl",
}


class Equilibria(NamedTuple):
    """Equilibria, first axis samples.

    Attributes
    ----------
    load, coordinate : (S, n + 3) Pa and N, m^3 and m
    energy : (S,) J
    answers : by the names of ``AXES``, units as in ``Snapshots``, with rates of coordinates in place of loads
    slopes : likewise (S, n + 3, ...), their change with each load, as far as it is known
    moment_gram : (a, a) kg, of all samples
    """

    load: np.ndarray
    coordinate: np.ndarray
    energy: np.ndarray
    answers: Answers
    slopes: Answers
    moment_gram: np.ndarray

    @property
    def compliance(self) -> np.ndarray:
        """(S, n + 3, n + 3) d coordinate / d load."""
        return self.answers["compliance"]

    def rows(self, index: np.ndarray | slice) -> "Equilibria":
        """Return the samples ``index``."""
        arrays = (self.load[index], self.coordinate[index], self.energy[index])
        parts = ({n: v[index] for n, v in part.items()} for part in (self.answers, self.slopes))
        return Equilibria(*arrays, *parts, self.moment_gram)


def equilibria(snapshots: Snapshots) -> Equilibria:
    """Return the equilibria of ``snapshots``, the plate's orientation as rotation vector (samples, 3) rad."""
    loads = {name: getattr(snapshots, name) for name in snapshots.slopes}
    scale = np.abs(snapshots.loads).max(axis=0)
    answers, slopes = _per_coordinate(loads), slopes_of(_per_coordinate, loads, snapshots.slopes, scale)
    rotation = rotation_vector(snapshots.tip_quaternion)
    moved = {
        "moments": (snapshots.moments, snapshots.moment_slope),
        "rotation": (rotation, per_spin(rotation) @ snapshots.tip_spin),
        "layer_energy": (snapshots.layer_energy, snapshots.layer_slope),
    }
    inverse = np.linalg.inv(snapshots.compliance)[:, None]
    answers |= {name: value for name, (value, _) in moved.items()}
    answers["viscosity_by_gravity"] = inverse @ snapshots.viscosity_by_gravity @ inverse
    answers |= {name: getattr(snapshots, name) for name in ("layer_give", "layer_drop", "layer_spin")}
    slopes |= {name: np.moveaxis(slope, -1, 1) for name, (_, slope) in moved.items()}
    return Equilibria(snapshots.loads, snapshots.coordinate, snapshots.energy, answers, slopes, snapshots.moment_gram)


def slopes_of(
    derived: Callable[[Answers], Answers], answers: Answers, slopes: Answers, scale: np.ndarray
) -> Answers:
    """Return the slopes (S, n + 3, ...) of what ``derived`` makes of ``answers``, by differences of ``STEP`` of ``scale``."""
    found = []
    for k, step in enumerate(STEP * scale):
        ends = [derived({n: v + s * step * slopes[n][:, k] for n, v in answers.items()}) for s in (1.0, -1.0)]
        found.append({name: (ahead - ends[1][name]) / (2.0 * step) for name, ahead in ends[0].items()})
    return {name: np.stack([slope[name] for slope in found], axis=1) for name in found[0]}


def rotation_vector(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (samples, 3) rad of ``quaternion`` (samples, 4) w x y z, turning by at most pi."""
    quaternion = np.where(quaternion[:, :1] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[:, 1:], axis=1)
    half = np.arctan2(sine, quaternion[:, 0])
    factor = np.where(sine > 1e-9, 2.0 * half / np.where(sine > 1e-9, sine, 1.0), 2.0)
    return quaternion[:, 1:] * factor[:, None]


def per_spin(rotation: np.ndarray) -> np.ndarray:
    """Return d rotation vector / d spin (samples, 3, 3) at rotation vectors (samples, 3), of less than a whole turn."""
    angle = np.linalg.norm(rotation, axis=1)[:, None, None]
    half = np.maximum(0.5 * angle, 1e-6)
    cross = np.cross(rotation[:, None, :], np.eye(3)).transpose(0, 2, 1)  # rotation x
    bend = np.where(angle > 1e-4, (1.0 - half / np.tan(half)) / np.maximum(angle, 1e-9) ** 2, 1.0 / 12.0)
    return np.eye(3) - 0.5 * cross + bend * cross @ cross


def _per_coordinate(answers: Answers) -> Answers:
    """Return the answers with rates of coordinates in place of rates of loads, and of the tip in place of those of its force.

    By the tip's motion the inside gives alike in stiff poses and in soft ones.
    """
    inverse = np.linalg.inv(answers["compliance"])
    per_tip = twice(np.linalg.inv(answers["compliance"][:, -3:, -3:]))
    turned = {"stiffness": inverse @ answers["tangent_stiffness"] @ inverse, "mass": inverse @ answers["tangent_mass"] @ inverse}
    turned |= {name: per_tip @ answers[name] @ inverse for name in ("inner_coupling", "inner_drag")}
    turned |= {name: per_tip @ answers[name] @ per_tip for name in ("inner_give", "inner_mass", "inner_viscosity")}
    turned["inner_spin"] = answers["inner_spin"] @ per_tip
    return {name: answers[name] for name in AXES if name in answers} | turned


def twice(matrices: np.ndarray) -> np.ndarray:
    """Return (..., 2 k, 2 k) with ``matrices`` (..., k, k) on the diagonal twice: what acts on two vectors alike."""
    nothing = np.zeros_like(matrices)
    return np.block([[matrices, nothing], [nothing, matrices]])
