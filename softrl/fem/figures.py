"""Figures of the full model: deformed shapes, sampled tips, Newton's convergence, trajectories."""

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots

SHAPES = 4


def draw_shapes(mesh: Mesh, snapshots: Snapshots) -> Figure:
    """Return the mesh in the x-z plane at rest and at the samples that bend furthest in different ways."""
    edges = surface_edges(mesh.tetrahedra)
    chosen = _spread(snapshots.coordinate[:, -3:], SHAPES)
    figure = Figure(figsize=(3.2 * (len(chosen) + 1), 4.2), layout="constrained")
    axes = figure.subplots(1, len(chosen) + 1, sharex=True, sharey=True)
    shapes = [("at rest", mesh.points)]
    for row in chosen:
        pressures = ", ".join(f"{round(p / 1e3)}" for p in snapshots.loads[row, : snapshots.chambers])
        shapes.append((f"p = {pressures} kPa", mesh.points + snapshots.displacement[row]))
    for axis, (title, points) in zip(axes, shapes, strict=True):
        axis.add_collection(LineCollection(1e3 * points[edges][:, :, [0, 2]], linewidths=0.25, colors="C0"))
        axis.set(title=title, xlabel="x (mm)", aspect="equal")
        axis.autoscale_view()
    axes[0].set_ylabel("z (mm)")
    return figure


def draw_stretch(mesh: Mesh, snapshots: Snapshots) -> Figure:
    """Return the surface at rest and in the samples that bend furthest, coloured by its largest stretch, from the side."""
    faces = surface_faces(mesh.tetrahedra)
    chosen = _spread(snapshots.coordinate[:, -3:], SHAPES)
    shapes = [("at rest", mesh.points)]
    for row in chosen:
        pressures = ", ".join(f"{round(p / 1e3)}" for p in snapshots.loads[row, : snapshots.chambers])
        shapes.append((f"p = {pressures} kPa", mesh.points + snapshots.displacement[row]))
    stretches = [largest_stretch(mesh.points[faces], points[faces]) for _, points in shapes]
    top = float(np.quantile(np.concatenate(stretches), 0.99))
    figure = Figure(figsize=(3.0 * len(shapes) + 1.0, 4.2), layout="constrained")
    axes = figure.subplots(1, len(shapes), sharex=True, sharey=True)
    for axis, (title, points), stretch in zip(axes, shapes, stretches, strict=True):
        order = np.argsort(-points[faces].mean(axis=1)[:, 1])  # what lies behind is drawn first
        drawn = PolyCollection(1e3 * points[faces[order]][:, :, [0, 2]], cmap="viridis", edgecolors="none")
        drawn.set(array=stretch[order], clim=(1.0, top))
        axis.add_collection(drawn)
        axis.set(title=title, xlabel="x (mm)", aspect="equal")
        axis.autoscale_view()
    axes[0].set_ylabel("z (mm)")
    figure.colorbar(drawn, ax=axes, label="largest stretch of the surface", extend="max", shrink=0.7)
    return figure


def largest_stretch(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the largest principal stretch (triangles,) in the plane of triangles (triangles, 3, 3)."""
    old, new = before[:, 1:] - before[:, :1], after[:, 1:] - after[:, :1]
    metric = [np.einsum("tai,tbi->tab", side, side) for side in (old, new)]
    change = np.linalg.solve(metric[0], metric[1])
    half, product = 0.5 * np.trace(change, axis1=1, axis2=2), np.linalg.det(change)
    return np.sqrt(half + np.sqrt(np.maximum(half**2 - product, 0.0)))


def draw_tips(snapshots: Snapshots) -> Figure:
    """Return the tips of all equilibria from above and from the side, coloured by mean pressure."""
    tip = 1e3 * (snapshots.rest_tip + snapshots.coordinate[:, -3:])
    mean = snapshots.loads[:, : snapshots.chambers].mean(axis=1) / 1e3
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, (i, j) in zip(axes, ((0, 1), (0, 2)), strict=True):
        points = axis.scatter(tip[:, i], tip[:, j], c=mean, s=18)
        axis.plot(*(1e3 * snapshots.rest_tip[[i, j]]), "k+", markersize=12)
        axis.set(xlabel=f"tip {'xyz'[i]} (mm)", ylabel=f"tip {'xyz'[j]} (mm)", aspect="equal")
    figure.colorbar(points, ax=axes, label="mean pressure (kPa)")
    figure.suptitle(f"{len(tip)} equilibria, + at rest")
    return figure


def draw_newton(histories: Sequence[tuple[float, ...]], tolerance_m: float) -> Figure:
    """Return the largest nodal shift of each Newton iteration, one line a sample."""
    figure = Figure(figsize=(5.5, 4.0), layout="constrained")
    axis = figure.subplots()
    for history in histories:
        axis.semilogy(np.arange(1, len(history) + 1), np.maximum(history, 1e-16), color="C0", alpha=0.25, lw=0.8)
    axis.axhline(tolerance_m, color="k", ls="--", lw=0.8, label="tolerance")
    axis.set(xlabel="iteration of the last load step", ylabel="largest nodal shift (m)")
    axis.legend()
    return figure


def draw_trajectories(snapshots: Snapshots) -> Figure:
    """Return pressures and tip displacements over time, one column a trajectory."""
    count = max(1, len(snapshots.trajectory_load))
    figure = Figure(figsize=(4.5 * count, 5.0), layout="constrained")
    axes = figure.subplots(2, count, sharex=True, sharey="row", squeeze=False)
    n = snapshots.chambers
    for k, (load, coordinate) in enumerate(
        zip(snapshots.trajectory_load, snapshots.trajectory_coordinate, strict=True)
    ):
        for i in range(n):
            axes[0, k].plot(snapshots.trajectory_time, load[:, i] / 1e3, label=f"chamber {i + 1}")
        for i in range(3):
            axes[1, k].plot(snapshots.trajectory_time, 1e3 * coordinate[:, n + i], label="xyz"[i])
        axes[1, k].set_xlabel("time (s)")
    axes[0, 0].set_ylabel("pressure (kPa)")
    axes[1, 0].set_ylabel("tip displacement (mm)")
    if len(snapshots.trajectory_load):
        axes[0, 0].legend()
        axes[1, 0].legend()
    return figure


def surface_faces(tetrahedra: np.ndarray) -> np.ndarray:
    """Return the faces (faces, 3) that belong to one tetrahedron only."""
    faces = np.sort(np.concatenate([tetrahedra[:, list(f)] for f in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]), 1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    return unique[count == 1]


def surface_edges(tetrahedra: np.ndarray) -> np.ndarray:
    """Return the edges (edges, 2) of the surface."""
    outer = surface_faces(tetrahedra)
    return np.unique(np.concatenate([outer[:, [0, 1]], outer[:, [1, 2]], outer[:, [0, 2]]]), axis=0)


def _spread(points: np.ndarray, count: int) -> list[int]:
    """Return rows far from rest and from each other, farthest first."""
    chosen: list[int] = []
    distance = np.linalg.norm(points, axis=1)
    for _ in range(min(count, len(points))):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen
