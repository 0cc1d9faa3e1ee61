"""Small bodies with known answers: a bar, a hollow box and a hollow sphere."""

from dataclasses import fields, replace

import numpy as np

from softrl.artifacts.mesh import BASE, PLATE, Mesh, tetrahedron_volumes
from softrl.artifacts.snapshots import Snapshots
from softrl.fem.assembly import ASSEMBLERS, node_pairs
from softrl.fem.coupling import Coupling
from softrl.fem.elements import EDGES, Solid, solid_of
from softrl.fem.law import TANGENT
from softrl.fem.material import Material, StableNeoHookean
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings, Value, minimise
from softrl.fem.solver import linear_solver
from softrl.robots.robot import Robot

KUHN = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
NEWTON = NewtonSettings(tolerance_m=1e-9, max_iterations=60, reuse_below=0.3)


def grid(cells: tuple[int, int, int], size: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (nodes, 3) m, tetrahedra and the cell (elements, 3) of each, of a box cut into cubes of six."""
    x, y, z = (np.linspace(0.0, s, n + 1) for s, n in zip(size, cells, strict=True))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    cell = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    bits = np.array([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)])
    corner = cell[:, None] + bits
    node = (corner[..., 0] * (cells[1] + 1) + corner[..., 1]) * (cells[2] + 1) + corner[..., 2]
    tetrahedra = node[:, KUHN].reshape(-1, 4)
    return points, oriented(points, tetrahedra), np.repeat(cell, 6, axis=0)


def oriented(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return ``tetrahedra`` with positive volume."""
    wrong = tetrahedron_volumes(points, tetrahedra) < 0
    return np.where(wrong[:, None], tetrahedra[:, [1, 0, 2, 3]], tetrahedra)


def boundary(tetrahedra: np.ndarray) -> np.ndarray:
    """Return the faces (faces, 3) that belong to one tetrahedron, normals out of the solid."""
    faces = np.concatenate([tetrahedra[:, f] for f in ([1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1])])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def hollow_box(
    cells: int = 3, width: float = 0.03, height: float = 0.05, chambers: int = 1, walls: int = 1
) -> Mesh:
    """Return a box on its base with ``chambers`` closed cavities side by side and a rigid plate on top.

    One box is ``cells`` wide with walls of ``walls`` cells; the plate is a layer of ``walls`` more on top.
    """
    inner = cells - 2 * walls
    shape = (cells + (chambers - 1) * (cells - walls), cells, cells + walls)
    points, tetrahedra, cell = grid(shape, (width * shape[0] / cells, width, height))
    hollow = (cell[:, 1:] >= walls).all(axis=1) & (cell[:, 1:] < walls + inner).all(axis=1)
    number = np.full(len(cell), -1)
    for k in range(chambers):
        low = walls + k * (cells - walls)
        number[hollow & (cell[:, 0] >= low) & (cell[:, 0] < low + inner)] = k
    solid = tetrahedra[number < 0]
    faces = boundary(solid)
    sorted_faces = np.sort(faces, axis=1)
    owner = np.full(len(faces), -1)
    for k in range(chambers):
        air = np.sort(boundary(tetrahedra[number == k]), axis=1)
        owner[(sorted_faces[:, None] == air).all(axis=2).any(axis=1)] = k
    used, renumbered = np.unique(solid, return_inverse=True)
    new = np.full(len(points), -1)
    new[used] = np.arange(len(used))
    points = points[used]
    region = np.zeros(len(points), dtype=int)
    region[points[:, 2] < 1e-9] = BASE
    region[points[:, 2] > height * cells / (cells + walls) - 1e-9] = PLATE
    cavity, layer = owner >= 0, (2 * cell[number < 0, 2] >= shape[2]).astype(int)
    return Mesh(points, renumbered.reshape(-1, 4), region, layer, new[faces[cavity]], owner[cavity], "box")


def bar(cells: tuple[int, int, int], size: tuple[float, float, float]) -> Mesh:
    """Return a bar along z: base at the bottom, plate at its top face, and no use of its one (dummy) cavity.

    The cavity is the whole outer surface turned inside out, so that its volume is that of the bar.
    """
    points, tetrahedra, _ = grid(cells, size)
    region = np.zeros(len(points), dtype=int)
    region[points[:, 2] < 1e-9] = BASE
    region[points[:, 2] > size[2] - 1e-9] = PLATE
    faces = boundary(tetrahedra)[:, ::-1]
    return Mesh(points, tetrahedra, region, np.zeros(len(tetrahedra), int), faces, np.zeros(len(faces), int), "bar")


def arch(rise: float, span: float = 0.04, thickness: float = 1e-3) -> Mesh:
    """Return a roof-shaped strip clamped at both ends along x, its ridge a plate: it snaps through under a force on it.

    Its one cavity is as in ``bar``.
    """
    points, tetrahedra, _ = grid((8, 1, 1), (span, 0.004, thickness))
    points = points - np.array([span / 2, 0.002, 0.0])
    side = np.abs(points[:, 0])
    region = np.where(side < 1e-9, PLATE, np.where(side > span / 2 - 1e-9, BASE, 0))
    points[:, 2] += rise * (1.0 - 2.0 * side / span)
    tetrahedra = oriented(points, tetrahedra)
    faces = boundary(tetrahedra)[:, ::-1]
    return Mesh(points, tetrahedra, region, np.zeros(len(tetrahedra), int), faces, np.zeros(len(faces), int), "arch")


def model_of(mesh: Mesh, material: Material | None = None, **changes: object) -> FemModel:
    """Return a model of ``mesh`` in rubber, 1 MPa unless given, without damping."""
    settings = {"density_kg_m3": 1000.0, "rayleigh_mass_per_s": 0.0, "rayleigh_stiffness_s": 0.0, "newton": NEWTON}
    return FemModel(mesh, material or StableNeoHookean(1e6, 0.45), **(settings | changes))  # type: ignore[arg-type]


def box_robot(chambers: int) -> Robot:
    """Return a robot whose limits suit ``hollow_box``."""
    return Robot(
        name="box", chamber_angle_deg=tuple(360.0 / chambers * k for k in range(chambers)), chamber_radius_m=0.01,
        chamber_area_m2=1e-4, length_m=0.05, mass_kg=0.04, pressure_min_pa=-5e3, pressure_max_pa=1e4,
        slew_pa_per_s=1e6, tip_force_max_n=0.5, axis="+z", output="tip_pose", command="pressure", command_to_pa=1.0,
        gravity_m_s2=(0.0, 0.0, -9.81),
    )


def hollow_sphere(inner: float, outer: float, layers: int = 3, cells: int = 3) -> Mesh:
    """Return a thick sphere of cube-shaped patches, held at three nodes' neighbourhood at its lowest point."""
    points, tetrahedra, cell = grid((cells + 2 * layers,) * 3, (2.0, 2.0, 2.0))
    points = points - 1.0
    core = ((cell >= layers) & (cell < layers + cells)).all(axis=1)
    edge = cells / (cells + 2 * layers)  # cube half-width of the cavity
    reach = np.abs(points).max(axis=1)
    length = np.maximum(np.linalg.norm(points, axis=1), 1e-12)
    radius = np.where(reach > edge, inner + (outer - inner) * (reach - edge) / (1 - edge), inner * reach / edge)
    points = points / length[:, None] * radius[:, None]
    solid = oriented(points, tetrahedra[~core])
    used, renumbered = np.unique(solid, return_inverse=True)
    points, solid = points[used], renumbered.reshape(-1, 4)
    faces = boundary(solid)
    cavity = faces[np.linalg.norm(points[faces].mean(axis=1), axis=1) < 0.5 * (inner + outer)]
    region = np.zeros(len(points), int)
    lowest, highest = solid[points[solid].mean(axis=1)[:, 2].argmin()], solid[points[solid].mean(axis=1)[:, 2].argmax()]
    region[lowest], region[highest] = BASE, PLATE
    return Mesh(points, solid, region, np.zeros(len(solid), int), cavity, np.zeros(len(cavity), int), "sphere")


def solved_inside(cells: int, exact, material, size=0.02, element_order: int = 2, mean: bool = False):  # type: ignore[no-untyped-def]
    """Return (nodes found, nodes exact, elements) of a cube whose whole surface follows ``exact`` (nodes, 3) -> (nodes, 3)."""
    points, tetrahedra, _ = grid((cells, cells, cells), (size, size, size))
    region = np.zeros(len(points), int)
    region[np.unique(boundary(tetrahedra))] = BASE
    region[(np.abs(points - size / 2) < size / 2 - 1e-9).all(axis=1)] = 0
    faces = boundary(tetrahedra)[:, ::-1]
    mesh = Mesh(points, tetrahedra, region, np.zeros(len(tetrahedra), int), faces, np.zeros(len(faces), int), "cube")
    q = solid_of(mesh, element_order)
    outer = (np.abs(q.points - size / 2) > size / 2 - 1e-9).any(axis=1)
    region10 = np.where(outer, BASE, 0)
    pairs = node_pairs(len(q.points), q.elements, q.cavity_triangles)
    coupling = Coupling(q.points, region10, [], np.zeros((0, 3)), pairs)
    rest = coupling.rest()
    start = replace(rest, position=np.where(outer[:, None], exact(q.points), rest.position))

    parameters, bulk = material.split() if mean else (material.pack(), 0.0)

    def objective(pose, order):  # type: ignore[no-untyped-def]
        gradient = np.zeros_like(pose.position)
        blocks = np.zeros((len(pairs.first), 3, 3))
        energy = ASSEMBLERS[q.elements.shape[1]](
            type(material).kernel, parameters, bulk, np.zeros(3), pose.position, pose.position, q.elements, q.gradients,
            q.weights, order, pairs.element_slots, gradient, blocks,
        )
        return Value(energy, gradient, blocks if order >= TANGENT else None)

    solve = minimise(objective, start, coupling, linear_solver(), NewtonSettings(1e-13, 60, 0.0))
    assert solve.converged
    return solve.pose.position, exact(q.points), q


def error_norms(found: np.ndarray, exact, gradient, solid: Solid) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Return the L2 norms of the error in position and in its gradient, by a fine quadrature."""
    corner = solid.points[solid.elements[:, :4]]
    inverse = np.linalg.inv(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))
    barycentric = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    volume, apart, tilt = solid.volumes(), 0.0, 0.0
    for share, weight in zip(QUADRATURE, QUADRATURE_WEIGHT, strict=True):
        if solid.elements.shape[1] == 4:
            shape, slope = share, barycentric
        else:
            shape = np.r_[share * (2 * share - 1), 4 * share[EDGES[:, 0]] * share[EDGES[:, 1]]]
            slope = np.concatenate([(4 * share - 1)[:, None] * barycentric, 4 * (
                share[EDGES[:, 0], None] * barycentric[:, EDGES[:, 1]]
                + share[EDGES[:, 1], None] * barycentric[:, EDGES[:, 0]])], axis=1)
        where, nodal = np.einsum("c,eci->ei", share, corner), found[solid.elements]
        apart += float((volume * weight) @ ((np.einsum("a,eai->ei", shape, nodal) - exact(where)) ** 2).sum(axis=1))
        miss = np.einsum("eai,eaj->eij", nodal, slope) - gradient(where)
        tilt += float((volume * weight) @ (miss**2).sum(axis=(1, 2)))
    return float(np.sqrt(apart)), float(np.sqrt(tilt))


def _rule() -> tuple[np.ndarray, np.ndarray]:
    """Return barycentric points (64, 4) and weights: a Gauss rule on the cube, folded onto the tetrahedron."""
    node, weight = np.polynomial.legendre.leggauss(4)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    u, v, w = (a.ravel() for a in np.meshgrid(node, node, node, indexing="ij"))
    wu, wv, ww = (a.ravel() for a in np.meshgrid(weight, weight, weight, indexing="ij"))
    r, s, t = u, v * (1 - u), w * (1 - u) * (1 - v)
    return np.stack([1 - r - s - t, r, s, t], axis=1), 6 * wu * wv * ww * (1 - u) ** 2 * (1 - v)


QUADRATURE, QUADRATURE_WEIGHT = _rule()


def assert_same(one: Snapshots, two: Snapshots) -> None:
    """Check that snapshots are the same but for round-off: the linear solver sums in another order with more threads."""
    for field in fields(Snapshots):
        mine, other = getattr(one, field.name), getattr(two, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_allclose(mine, other, rtol=1e-6, atol=1e-8 * np.abs(mine).max(initial=0.0), err_msg=field.name)
        elif field.name != "slopes":
            assert mine == other, field.name
    for name, slope in one.slopes.items():  # a difference quotient magnifies round-off
        np.testing.assert_allclose(slope, two.slopes[name], rtol=1e-6, atol=1e-5 * np.abs(slope).max(), err_msg=name)
