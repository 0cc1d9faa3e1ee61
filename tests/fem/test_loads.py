"""Laws of the cavity volume, whose derivative is the follower pressure's force."""

import numpy as np
import pytest

from softrl.fem.assembly import multiply_blocks, node_pairs
from softrl.fem.elements import Solid, quadratic_mesh
from softrl.fem.loads import (
    USED_TRIPLES,
    WEIGHTS,
    add_volume_gradient,
    add_volume_stiffness,
    enclosed_volumes,
)
from tests.fem.bodies import hollow_box

PRESSURE = np.array([2.0e3, -1.0e3])


@pytest.fixture(scope="module")
def solid() -> Solid:
    return quadratic_mesh(hollow_box(chambers=2))


def volumes(solid: Solid, x: np.ndarray) -> np.ndarray:
    return enclosed_volumes(x, solid.cavity_triangles, solid.cavity_of_triangle, USED_TRIPLES, WEIGHTS, 2)


def force(solid: Solid, x: np.ndarray) -> np.ndarray:
    total = np.zeros_like(x)
    add_volume_gradient(x, solid.cavity_triangles, solid.cavity_of_triangle, USED_TRIPLES, WEIGHTS, PRESSURE, total)
    return total


def test_volume_of_a_box_is_exact_when_stretched_and_moved(solid: Solid) -> None:
    exact = 0.01 * 0.01 * 0.0125
    assert volumes(solid, solid.points) == pytest.approx([exact, exact], rel=1e-12)
    change = np.eye(3) + 0.2 * np.random.default_rng(0).standard_normal((3, 3))
    moved = solid.points @ change.T + [1.0, -2.0, 0.5]
    assert volumes(solid, moved) == pytest.approx(exact * np.linalg.det(change) * np.ones(2), rel=1e-9)


def test_volume_of_a_bulged_box_is_that_of_the_curved_faces(solid: Solid) -> None:
    # z -> z + k x (w - x) is quadratic, so the curved tetrahedra follow it exactly; it keeps volume (shear)
    x = solid.points.copy()
    x[:, 2] += 20.0 * x[:, 0] * (0.05 - x[:, 0])
    assert volumes(solid, x) == pytest.approx(volumes(solid, solid.points), rel=1e-12)


def test_force_is_the_gradient_and_stiffness_the_hessian(solid: Solid) -> None:
    rng = np.random.default_rng(1)
    x = solid.points + 1e-3 * rng.standard_normal(solid.points.shape)
    along, step = rng.standard_normal(x.shape), 1e-7
    energies = [-PRESSURE @ volumes(solid, x + s * step * along) for s in (1, -1)]
    assert (energies[0] - energies[1]) / (2 * step) == pytest.approx(-(force(solid, x) * along).sum(), rel=1e-6)
    pairs = node_pairs(len(x), solid.elements, solid.cavity_triangles)
    blocks = np.zeros((len(pairs.first), 3, 3))
    add_volume_stiffness(
        x,
        solid.cavity_triangles,
        solid.cavity_of_triangle,
        USED_TRIPLES,
        WEIGHTS,
        PRESSURE,
        pairs.triangle_slots,
        blocks,
    )
    numeric = -(force(solid, x + step * along) - force(solid, x - step * along)) / (2 * step)
    found = multiply_blocks(blocks, pairs.first, pairs.second, along)
    assert np.abs(found - numeric).max() < 1e-6 * np.abs(numeric).max()


def test_a_closed_cavity_pushes_with_no_net_force_or_moment(solid: Solid) -> None:
    x = solid.points + 1e-3 * np.random.default_rng(2).standard_normal(solid.points.shape)
    push = force(solid, x)
    assert np.abs(push.sum(axis=0)).max() < 1e-12 * np.abs(push).sum()
    assert np.abs(np.cross(x, push).sum(axis=0)).max() < 1e-12 * np.abs(push).sum()
