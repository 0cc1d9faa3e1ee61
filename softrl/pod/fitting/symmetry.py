"""What the symmetries of a robot make of equilibria, and how much that counts."""

import numpy as np

from softrl.fem.moments import turned
from softrl.pod.fitting.equilibria import AXES, Equilibria, twice
from softrl.robots.symmetry import Symmetry

ROUND_OFF = 1e-9  # of what is largest
ALIKE = 1.5  # times the least error: weights of images that do about as well


def reflected(samples: Equilibria, operations: list[Symmetry]) -> Equilibria:
    """Return ``samples`` and their images under all ``operations``, operation by operation."""
    images = [_image(samples, operation) for operation in operations]
    arrays = (np.concatenate([getattr(image, name) for image in images]) for name in ("load", "coordinate", "energy"))
    parts = ([getattr(image, name) for image in images] for name in ("answers", "slopes"))
    joined = ({n: np.concatenate([part[n] for part in of]) for n in of[0]} for of in parts)
    return Equilibria(*arrays, *joined, samples.moment_gram)


def lopsided(samples: Equilibria, operation: Symmetry, frame: np.ndarray) -> float:
    """Return how far the mass at rest is from that of its image under ``operation``, as a share of itself.

    It is that of the motion that moments know, of the sample nearest to rest, in coordinates y with ``z = frame y``: it tells
    a body beside the z axis from one on it, too.
    """
    nearest = np.linalg.norm(np.linalg.solve(frame, samples.coordinate.T), axis=0).argmin()
    own = samples.rows(np.array([nearest]))
    metric = np.linalg.pinv(samples.moment_gram, rcond=ROUND_OFF, hermitian=True)
    masses = []
    for seen in (own, _image(own, operation)):
        slopes = seen.slopes["moments"][0]
        per_load = np.linalg.solve(frame, seen.compliance[0]).T
        moments = np.linalg.solve(per_load, slopes.reshape(len(slopes), -1)).reshape(slopes.shape)
        masses.append(np.einsum("ixd,xy,jyd->ij", moments, metric, moments, optimize=True))
    return float(np.linalg.norm(masses[1] - masses[0]) / np.linalg.norm(masses[0]))


def weight_to_trust(errors: dict[float, float]) -> float:
    """Return the largest weight of images whose error in cross-validation, of ``errors`` by weight, is about the least.

    Samples have near neighbours on their paths, which flatters a fit without images; where no sample stands, images are all
    that a fit has. On a lopsided mesh they cost more than that.
    """
    least = min(errors.values())
    return max(weight for weight, error in errors.items() if error <= ALIKE * least)


def _image(samples: Equilibria, operation: Symmetry) -> Equilibria:
    g, vector = operation
    moments = turned(vector, len(samples.moment_gram))
    turns = {"w": g, "v": vector, "i": twice(vector), "s": np.linalg.det(vector) * vector, "m": moments}

    def image(values: np.ndarray, axes: str) -> np.ndarray:
        for place, axis in enumerate(axes, start=1):
            if axis == "l":
                continue  # a symmetry leaves each layer in its place
            values = np.moveaxis(np.tensordot(values, turns[axis], axes=(place, 1)), -1, place)
        return values

    return Equilibria(
        image(samples.load, "w"),
        image(samples.coordinate, "w"),
        samples.energy,
        {name: image(values, AXES[name]) for name, values in samples.answers.items()},
        {name: image(values, "w" + AXES[name]) for name, values in samples.slopes.items()},
        samples.moment_gram,
    )
