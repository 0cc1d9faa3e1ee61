"""How far a mesh is from the converged answer: the same solid cut finer and finer, and the limit of its tip.

Cutting every tetrahedron into equal parts keeps solid, regions and cavities exactly, so that the tips differ by the
discretisation alone and their limit can be extrapolated. Meshes made anew would also differ in shape, and fTetWild
makes each of them by chance.
"""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.optimize import brentq

from softrl.artifacts.mesh import FREE, Mesh, tetrahedron_volumes
from softrl.core.errors import ConfigError, SolverError
from softrl.fem.material import Material
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings

log = logging.getLogger(__name__)
LOWEST_ORDER, HIGHEST_ORDER = 0.2, 8.0  # between which an order of convergence is sought


@dataclass(frozen=True)
class Study:
    """Tips of one solid under one load on finer and finer elements.

    Attributes
    ----------
    parts : (meshes,) into how many an edge was cut
    edge_m : (meshes,) m, cube root of six times the mean volume of an element
    unknowns : (meshes,)
    tip_m : (meshes, 3) displacement of the tip, m
    seconds : (meshes,) processor time of each equilibrium
    order : the power of the edge with which the tip converges
    limit_m : (3,) m, the extrapolated displacement of the tip
    """

    parts: np.ndarray
    edge_m: np.ndarray
    unknowns: np.ndarray
    tip_m: np.ndarray
    seconds: np.ndarray
    order: float
    limit_m: np.ndarray

    @property
    def error_pct(self) -> np.ndarray:
        """Distance (meshes,) of each tip from the limit, in per cent of the limit's displacement."""
        return 100.0 * np.linalg.norm(self.tip_m - self.limit_m, axis=1) / np.linalg.norm(self.limit_m)


def study(
    mesh: Mesh,
    material: Material,
    load: np.ndarray,
    newton: NewtonSettings,
    parts: Sequence[int] = (1, 2, 3),
    element_order: int = 2,
    mean_dilatation: bool = True,
) -> Study:
    """Return the tips of ``mesh`` under ``load`` (chambers + 3,) Pa and N, each edge cut into ``parts`` in turn.

    Raises
    ------
    SolverError
        If an equilibrium is not found, or the tips do not converge.
    """
    if len(parts) < 3 or list(parts) != sorted(set(parts)):
        raise ConfigError(f"parts={list(parts)}; expected three or more rising numbers, to find order and limit")
    rows = []
    for count in parts:
        fine = refine(mesh, count)
        model = FemModel(
            fine, material, 1000.0, 0.0, 0.0, newton, element_order=element_order, mean_dilatation=mean_dilatation
        )
        began = time.process_time()
        solve = model.static(load)
        if not solve.converged:
            raise SolverError(f"no equilibrium on {model.coupling.unknowns} unknowns; use a smaller load")
        tip, seconds = model.tip(solve.pose) - model.rest_tip, time.process_time() - began
        edge = float(np.cbrt(6.0 * tetrahedron_volumes(fine.points, fine.tetrahedra).mean()))
        rows.append((edge, model.coupling.unknowns, tip, seconds))
        log.info("%d unknowns: tip displaced %s mm, %.0f s", rows[-1][1], np.round(1e3 * tip, 3), seconds)
    edge_m, unknowns, tip_m, seconds_ = (np.array(column) for column in zip(*rows, strict=True))
    order, limit = extrapolate(edge_m, tip_m)
    return Study(np.array(parts), edge_m, unknowns, tip_m, seconds_, order, limit)


def extrapolate(edge: np.ndarray, tip: np.ndarray) -> tuple[float, np.ndarray]:
    """Return (order p, limit (3,)) of tip = limit + c edge^p through the three finest of ``edge`` (meshes,).

    The order is that of the changes' length, one for all components.
    """
    h, x = np.asarray(edge, float)[-3:], np.asarray(tip, float)[-3:]
    first, second = np.linalg.norm(x[1] - x[0]), np.linalg.norm(x[2] - x[1])

    def excess(p: float) -> float:
        return float((h[0] ** p - h[1] ** p) * second - (h[1] ** p - h[2] ** p) * first)

    if excess(LOWEST_ORDER) * excess(HIGHEST_ORDER) > 0:
        raise SolverError(
            f"the tip does not converge: it changes by {1e3 * first:.3g} and then by {1e3 * second:.3g} mm; "
            "use finer meshes, or a smaller load"
        )
    order = float(brentq(excess, LOWEST_ORDER, HIGHEST_ORDER))
    return order, x[2] + (x[2] - x[1]) * h[2] ** order / (h[1] ** order - h[2] ** order)


def refine(mesh: Mesh, parts: int) -> Mesh:
    """Return ``mesh`` with every edge cut into ``parts`` and every tetrahedron into ``parts`` cubed.

    A new node is in a region if all corners of the edge, face or tetrahedron that it lies in are.
    """
    if parts < 1:
        raise ConfigError(f"parts={parts} must be at least 1")
    if parts == 1:
        return mesh
    solid, tetrahedra = _lattice(4, parts), _tetrahedra_of(parts)
    face, triangles = _lattice(3, parts), _triangles_of(parts)
    key = np.concatenate(
        [
            _keys(mesh.tetrahedra, solid).reshape(-1, 8),
            _keys(mesh.cavity_triangles, face).reshape(-1, 8),
        ]
    )
    unique, number = np.unique(key, axis=0, return_inverse=True)
    number = number.ravel()
    inside = number[: len(mesh.tetrahedra) * len(solid)].reshape(-1, len(solid))
    surface = number[len(mesh.tetrahedra) * len(solid) :].reshape(-1, len(face))
    corner, weight = unique[:, :4], unique[:, 4:]
    points = np.einsum("nc,nci->ni", weight / parts, mesh.points[corner])
    region = mesh.node_region[corner]
    alike = ((region == region[:, :1]) | (weight == 0)).all(axis=1)
    diagonal = _shortest_diagonal(points, inside, solid)
    cut = np.where(
        diagonal[:, None, None] == 0,
        inside[:, tetrahedra[0]],
        np.where(diagonal[:, None, None] == 1, inside[:, tetrahedra[1]], inside[:, tetrahedra[2]]),
    ).reshape(-1, 4)
    flipped = tetrahedron_volumes(points, cut) < 0
    cut[flipped] = cut[flipped][:, [1, 0, 2, 3]]
    return Mesh(
        points,
        cut,
        np.where(alike, region[:, 0], FREE),
        np.repeat(mesh.element_layer, parts**3),
        surface[:, triangles].reshape(-1, 3),
        np.repeat(mesh.cavity_of_triangle, parts**2),
        mesh.robot_name,
    )


def draw_convergence(studies: dict[str, Study]) -> Figure:
    """Return the tip's distance from the limit against the unknowns, one line for each named study."""
    figure = Figure(figsize=(5.8, 4.2), layout="constrained")
    axis = figure.subplots()
    for k, (name, found) in enumerate(studies.items()):
        label = f"{name}: order {found.order:.1f}, limit {1e3 * np.linalg.norm(found.limit_m):.2f} mm"
        axis.loglog(found.unknowns, found.error_pct, "o-", color=f"C{k}", label=label)
    axis.axhline(2.0, color="k", ls="--", lw=0.8, label="2 %")
    axis.set(xlabel="unknowns", ylabel="tip's distance from the limit (% of its motion)")
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(which="both", lw=0.2)
    axis.legend()
    return figure


def _lattice(corners: int, parts: int) -> np.ndarray:
    """Return the integer barycentric points (points, corners), of sum ``parts``, in lexicographic order."""
    return np.array([w for w in product(range(parts + 1), repeat=corners) if sum(w) == parts])


def _keys(cells: np.ndarray, lattice: np.ndarray) -> np.ndarray:
    """Return (cells, points, 8): node numbers and weights by rising node, the same for a point shared by cells."""
    shape = (len(cells), *lattice.shape)
    weight = np.broadcast_to(lattice, shape)
    anchor = cells[:, None, :]
    # a corner without weight is replaced by one that has some, so that it does not tell two cells apart
    heaviest = np.take_along_axis(np.broadcast_to(anchor, shape), weight.argmax(axis=2)[..., None], axis=2)
    node = np.where(weight > 0, anchor, np.iinfo(np.int64).max)
    order = np.argsort(node, axis=2, kind="stable")
    node, weight = np.take_along_axis(node, order, axis=2), np.take_along_axis(weight, order, axis=2)
    node = np.where(weight > 0, node, np.minimum(node[..., :1], heaviest))
    missing = 4 - shape[2]
    if missing:
        node = np.concatenate([node, np.repeat(node[..., :1], missing, axis=2)], axis=2)
        weight = np.concatenate([weight, np.zeros((*shape[:2], missing), weight.dtype)], axis=2)
    return np.concatenate([node, weight], axis=2)


def _tetrahedra_of(parts: int) -> np.ndarray:
    """Return (3 diagonals, parts^3, 4) lattice points of the small tetrahedra, for each diagonal of the octahedra."""
    at = {tuple(w): n for n, w in enumerate(_lattice(4, parts))}
    unit = np.eye(4, dtype=int)

    def point(base: tuple[int, ...], *steps: int) -> int:
        return at[tuple(np.add(base, sum(unit[s] for s in steps)))]

    upright = [[point(b, c) for c in range(4)] for b in map(tuple, _lattice(4, parts - 1))]
    turned = [
        [point(b, *[c for c in range(4) if c != left]) for left in range(4)]
        for b in (map(tuple, _lattice(4, parts - 3)) if parts >= 3 else ())
    ]
    choices = []
    for across in ((0, 1), (0, 2), (0, 3)):
        other = tuple(c for c in range(4) if c not in across)
        pieces = []
        for b in map(tuple, _lattice(4, parts - 2)):
            ends = point(b, *across), point(b, *other)
            ring = [point(b, across[i], other[j]) for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))]
            pieces += [[*ends, ring[k], ring[(k + 1) % 4]] for k in range(4)]
        choices.append(upright + turned + pieces)
    return np.array(choices)


def _triangles_of(parts: int) -> np.ndarray:
    """Return (parts^2, 3) lattice points of the small triangles, turned as the large one."""
    at = {tuple(w): n for n, w in enumerate(_lattice(3, parts))}
    unit = np.eye(3, dtype=int)
    upright = [[at[tuple(b + unit[c])] for c in range(3)] for b in _lattice(3, parts - 1)]
    turned = [[at[tuple(b + 1 - unit[c])] for c in range(3)] for b in _lattice(3, parts - 2)]
    return np.array(upright + turned)


def _shortest_diagonal(points: np.ndarray, inside: np.ndarray, lattice: np.ndarray) -> np.ndarray:
    """Return for each large tetrahedron which of its octahedra's three diagonals is the shortest (0, 1, 2)."""
    parts = int(lattice[0].sum())
    ends = inside[
        :, [int(np.flatnonzero((lattice == parts * np.eye(4, dtype=int)[c]).all(axis=1))[0]) for c in range(4)]
    ]
    x = points[ends]
    lengths = [np.linalg.norm(x[:, 0] + x[:, k] - sum(x[:, c] for c in (1, 2, 3) if c != k), axis=1) for k in (1, 2, 3)]
    return np.argmin(lengths, axis=0)
