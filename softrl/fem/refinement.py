"""Where further equilibria tell most: where those at hand, each with how it answers its loads, disagree about the tip."""

import numpy as np
from scipy.spatial import cKDTree

from softrl.fem.chain import SLOPE, Found

NEIGHBOURS = 3


def where_they_disagree(
    loads: np.ndarray, known: np.ndarray, samples: list[Found], scale: np.ndarray, count: int
) -> np.ndarray:
    """Return the numbers of up to ``count`` of ``loads`` (candidates, w) about whose tip the nearest ``samples`` disagree most.

    ``known`` (K, w) are the loads among which the samples are numbered. Each sample goes on by its compliance and by how
    that changes with the load; half of that change is what a Taylor series has in second order. Of candidates between the
    same samples one is taken, so that they spread.
    """
    near, spread = disagreement(loads, known, samples, scale)
    chosen, taken = [], set[frozenset[int]]()
    for row in np.argsort(-spread, kind="stable"):
        if len(chosen) < count and (between := frozenset(near[row].tolist())) not in taken:
            chosen.append(int(row))
            taken.add(between)
    return np.array(chosen, dtype=int)


def disagreement(
    loads: np.ndarray, known: np.ndarray, samples: list[Found], scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each of ``loads`` (L, w) the nearest samples (L, k), and by how much (L,) m the nearest errs about the tip.

    That is its part of what the others differ from it, as errors grow with the cube of the distance. ``known`` (K, w) are the
    loads among which ``samples`` are numbered; distances are in units of ``scale`` (w,).
    """
    at = known[[number for number, _, _ in samples]]
    far, near = cKDTree(at / scale).query(loads / scale, k=min(NEIGHBOURS, len(at)))
    far, near = (values.reshape(len(loads), -1) for values in (far, near))
    tip, slope, bend = (
        np.array([row[name][-3:] if name == "coordinate" else row[name][..., -3:, :] for _, row, _ in samples])
        for name in ("coordinate", "compliance", SLOPE + "compliance")
    )
    ahead = loads[:, None] - at[near]
    expected = tip[near] + np.einsum("lkiw,lkw->lki", slope[near], ahead)
    expected += 0.5 * np.einsum("lkviw,lkw,lkv->lki", bend[near], ahead, ahead)
    apart = np.linalg.norm(expected[:, 1:] - expected[:, :1], axis=2)
    own = far[:, :1] ** 3 / np.maximum(far[:, :1] ** 3 + far[:, 1:] ** 3, 1e-300)
    return near, (apart * own).mean(axis=1) if apart.size else np.zeros(len(loads))
