"""Pictures of a mesh: cuts with the regions in colour, and the quality of its elements."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from softrl.artifacts.mesh import BASE, FIRST_RIB, FREE, PLATE, Mesh

LAYER_SHADES = ("#f3e5c8", "#e2cda4")
RIGID = {BASE: "#444444", PLATE: "tab:blue", FIRST_RIB: "tab:red"}
# corners of the polygon in which a plane cuts a tetrahedron, as pairs of nodes that the plane separates
EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def draw_cuts(mesh: Mesh, angle_deg: float, height_m: float) -> Figure:
    """Return cuts along the robot through the chamber at ``angle_deg`` and across it at ``height_m``."""
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    along, across = figure.subplots(1, 2)
    angle = np.deg2rad(angle_deg)
    outward, side = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([-np.sin(angle), np.cos(angle), 0.0])
    _draw_cut(along, mesh, mesh.points @ side, np.c_[mesh.points @ outward, mesh.points[:, 2]])
    along.set(xlabel=f"towards {angle_deg:g} deg (mm)", ylabel="z (mm)", title="along the robot, through chamber 1")
    _draw_cut(across, mesh, mesh.points[:, 2] - height_m, mesh.points[:, :2])
    across.set(xlabel="x (mm)", ylabel="y (mm)", title=f"across the robot, z = {1e3 * height_m:.1f} mm")
    names = {"base, fixed": RIGID[BASE], "plate, rigid": RIGID[PLATE], "ribs, rigid": RIGID[FIRST_RIB],
             "layers": LAYER_SHADES[0]}  # fmt: skip
    handles = [Patch(facecolor=colour, edgecolor="k", label=name) for name, colour in names.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    return figure


def _draw_cut(axes: Axes, mesh: Mesh, distance: np.ndarray, plane: np.ndarray) -> None:
    """Draw where ``distance`` (nodes,) from the cutting plane vanishes, at coordinates ``plane`` (nodes, 2) m."""
    side = distance[mesh.tetrahedra] > 0
    cut = np.flatnonzero(side.any(axis=1) & ~side.all(axis=1))
    polygons = [_cut_polygon(mesh.tetrahedra[e], distance, plane) for e in cut]
    colours = [_colour(mesh, int(e)) for e in cut]
    axes.add_collection(PolyCollection(polygons, facecolors=colours, edgecolors="k", linewidths=0.3))
    axes.autoscale_view()
    axes.set_aspect("equal")


def _cut_polygon(nodes: np.ndarray, distance: np.ndarray, plane: np.ndarray) -> np.ndarray:
    corners = []
    for a, b in EDGES:
        da, db = distance[nodes[a]], distance[nodes[b]]
        if (da > 0) != (db > 0):
            share = da / (da - db)
            corners.append((1.0 - share) * plane[nodes[a]] + share * plane[nodes[b]])
    polygon = 1e3 * np.array(corners)
    offset = polygon - polygon.mean(axis=0)
    return polygon[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]


def _colour(mesh: Mesh, element: int) -> str:
    region = mesh.node_region[mesh.tetrahedra[element]]
    if region[0] != FREE and (region == region[0]).all():
        return RIGID[min(int(region[0]), FIRST_RIB)]
    return LAYER_SHADES[int(mesh.element_layer[element]) % len(LAYER_SHADES)]


def draw_quality(angle: np.ndarray, limit_deg: float) -> Figure:
    """Return the histogram of the elements' smallest dihedral ``angle`` (elements,) in degrees."""
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    axes.hist(angle, bins=np.arange(0.0, 72.0, 1.5).tolist(), color="tab:blue")
    axes.axvline(limit_deg, color="k", linestyle="--", label=f"refused below {limit_deg:g} deg")
    axes.axvline(70.53, color="0.6", linestyle=":", label="regular tetrahedron")
    title = f"{len(angle)} elements, smallest {angle.min():.1f} deg, median {np.median(angle):.1f} deg"
    axes.set(xlabel="smallest dihedral angle of an element (deg)", ylabel="elements", title=title)
    axes.legend(fontsize=8)
    return figure
