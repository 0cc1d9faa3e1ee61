"""How far a mesh is from the converged answer: the same solid cut finer and finer, and the limit of its tip."""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy.optimize import brentq

from softrl.artifacts.mesh import Mesh, tetrahedron_volumes
from softrl.core.errors import ConfigError, SolverError
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.refine import carried, refine

log = logging.getLogger(__name__)
LOWEST_ORDER, HIGHEST_ORDER = 0.2, 8.0  # between which an order of convergence is sought
CREDIBLE_ORDER = (0.5, 3.0)  # what elements of second order show on a solid with sharp corners
SAFETY, SAFETY_IN_DOUBT = 1.25, 3.0  # Roache's factors for three meshes whose order is credible, and else


class Limit(NamedTuple):
    """What tips on finer and finer meshes tend to.

    Attributes
    ----------
    order : the power of the edge with which they do; 0 where they follow no power
    value_m : (3,) m, the extrapolated displacement; that on the finest mesh where there is no order
    uncertainty_m : m, how far from it the true limit may lie
    """

    order: float
    value_m: np.ndarray
    uncertainty_m: float


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
    limit : of the three finest
    """

    parts: np.ndarray
    edge_m: np.ndarray
    unknowns: np.ndarray
    tip_m: np.ndarray
    seconds: np.ndarray
    limit: Limit

    @property
    def error_pct(self) -> np.ndarray:
        """Distance (meshes,) of each tip from the limit, in per cent of the limit's displacement."""
        return 100.0 * np.linalg.norm(self.tip_m - self.limit.value_m, axis=1) / np.linalg.norm(self.limit.value_m)

    @property
    def uncertainty_pct(self) -> float:
        """How far the limit itself may be off, in per cent of its displacement."""
        return 100.0 * self.limit.uncertainty_m / float(np.linalg.norm(self.limit.value_m))


def study(
    body: Callable[[Mesh], FemModel], mesh: Mesh, load: np.ndarray, parts: Sequence[int] = (1, 2, 3)
) -> Study:
    """Return the tips of what ``body`` makes of ``mesh`` under ``load``, each edge cut into ``parts`` in turn.

    Each finer body starts in the shape of the one before, which saves it half of its iterations.

    Raises
    ------
    SolverError
        If an equilibrium is not found.
    """
    if len(parts) < 3 or list(parts) != sorted(set(parts)) or parts[0] != 1:
        raise ConfigError(f"parts={list(parts)}; expected 1 and two or more rising numbers, to find order and limit")
    rows: list[tuple[float, int, np.ndarray, float]] = []
    before: tuple[FemModel, Pose] | None = None
    for count in parts:
        fine = refine(mesh, count)
        model = body(fine)
        began = time.process_time()
        pose = _equilibrium(model, load, None if before is None else carried(*before, model, mesh))
        tip, seconds = model.tip(pose) - model.rest_tip, time.process_time() - began
        before = model, pose
        edge = float(np.cbrt(6.0 * tetrahedron_volumes(fine.points, fine.tetrahedra).mean()))
        rows.append((edge, model.coupling.unknowns, tip, seconds))
        log.info("%d unknowns: tip displaced %s mm, %.0f s", rows[-1][1], np.round(1e3 * tip, 3), seconds)
    edge_m, unknowns, tip_m, seconds_ = (np.array(column) for column in zip(*rows, strict=True))
    return Study(np.array(parts), edge_m, unknowns, tip_m, seconds_, extrapolate(edge_m, tip_m))


def extrapolate(edge: np.ndarray, tip: np.ndarray) -> Limit:
    """Return the limit of tip = limit + c edge^p through the three finest of ``edge`` (meshes,).

    Notes
    -----
    The order is that of the changes' length, one for all components. The uncertainty is the grid convergence index of the
    finest mesh, 1.25 times its distance from the limit; 3 times where the order is not credible or the tips turn back on
    their way. Where they follow no power it is three times the largest difference between them.
    """
    h, x = np.asarray(edge, float)[-3:], np.asarray(tip, float)[-3:]
    first, second = np.linalg.norm(x[1] - x[0]), np.linalg.norm(x[2] - x[1])

    def excess(p: float) -> float:
        return float((h[0] ** p - h[1] ** p) * second - (h[1] ** p - h[2] ** p) * first)

    if excess(LOWEST_ORDER) * excess(HIGHEST_ORDER) > 0:
        log.warning("the tip follows no power of the edge: it changes by %.3g, then %.3g mm", 1e3 * first, 1e3 * second)
        return Limit(0.0, x[2], SAFETY_IN_DOUBT * float(max(first, second, np.linalg.norm(x[2] - x[0]))))
    order = float(brentq(excess, LOWEST_ORDER, HIGHEST_ORDER))
    rest = (x[2] - x[1]) * h[2] ** order / (h[1] ** order - h[2] ** order)
    onward = float((x[1] - x[0]) @ (x[2] - x[1])) > 0.0  # else the tips swing round the limit
    credible = onward and CREDIBLE_ORDER[0] <= order <= CREDIBLE_ORDER[1]
    safety = SAFETY if credible else SAFETY_IN_DOUBT
    return Limit(order, x[2] + rest, safety * float(np.linalg.norm(rest)))


def draw_convergence(studies: dict[str, Study]) -> Figure:
    """Return how far the tip moves, and its distance from the limit, against the unknowns: one line a study."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    tips, errors = figure.subplots(1, 2)
    for k, (name, found) in enumerate(studies.items()):
        limit, doubt = 1e3 * np.linalg.norm(found.limit.value_m), 1e3 * found.limit.uncertainty_m
        tips.semilogx(found.unknowns, 1e3 * np.linalg.norm(found.tip_m, axis=1), "o-", color=f"C{k}", label=name)
        tips.axhspan(limit - doubt, limit + doubt, color=f"C{k}", alpha=0.15)
        tips.axhline(limit, color=f"C{k}", ls=":", label=f"limit {limit:.2f} ± {doubt:.2f} mm")
        label = f"{name}, order {found.limit.order:.1f}" if found.limit.order else f"{name}, from the finest"
        errors.loglog(found.unknowns, np.maximum(found.error_pct, 1e-3), "o-", color=f"C{k}", label=label)
    errors.axhline(2.0, color="k", ls="--", lw=0.8, label="2 %")
    tips.set(ylabel="displacement of the tip (mm)")
    errors.set(ylabel="distance from the limit (% of its motion)")
    for axis in (tips, errors):
        axis.set_xlabel("unknowns")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(which="both", lw=0.2)
        axis.legend(fontsize=8)
    return figure


def _equilibrium(model: FemModel, load: np.ndarray, start: Pose | None) -> Pose:
    """Return the equilibrium near ``start``; from rest it is approached in two halves of the load."""
    for share in (0.5, 1.0) if start is None else (1.0,):
        solve = model.static(share * load, start)
        if solve.failure:
            raise SolverError(f"no equilibrium on {model.coupling.unknowns} unknowns: {solve.failure}; use a smaller load")
        start = solve.pose
    assert start is not None
    return start
