"""Laws of a mesh made of one sector: it is the solid's, it is symmetric, and its images meet face to face."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from softrl.artifacts.mesh import tetrahedron_volumes
from softrl.core.errors import MeshError
from softrl.mesh.cavity import find_cavities
from softrl.mesh.geometry import build_tripod
from softrl.mesh.sample import read_sample
from softrl.mesh.sector import Sector, fill, sector_of, whole_of
from softrl.mesh.stage import Config
from softrl.mesh.surface import Surface, check_closed
from softrl.mesh.tetrahedra import tidy


@pytest.fixture(scope="module")
def config(configure) -> Config:
    return configure(profile="tiny")


@pytest.fixture(scope="module")
def surface(config, robot) -> Surface:
    return build_tripod(config.geometry, robot)


@pytest.fixture(scope="module")
def sector(surface, robot) -> Sector:
    found = sector_of(surface, robot)
    assert found is not None
    return found


def image_error(points: np.ndarray, image: np.ndarray) -> float:
    return float(cKDTree(points).query(points @ image.T)[0].max())


def test_sector_is_its_share_of_the_solid(surface, sector) -> None:
    check_closed(sector.surface.triangles, sector.surface.points, "sector")
    assert len(sector.images) * sector.surface.volume() == pytest.approx(surface.volume(), rel=1e-3)
    assert (sector.surface.points @ sector.inward.T).min() > -1e-6
    unique = {tuple(np.round(image.ravel(), 6)) for image in sector.images}
    assert len(unique) == 6


def test_mesh_is_symmetric_and_its_images_meet_face_to_face(surface, sector, config, robot) -> None:
    whole = fill(surface, robot, config.of_tripod())
    assert max(image_error(whole.points, image) for image in sector.images) < 1e-9
    assert tetrahedron_volumes(whole.points, whole.corners).min() > 0.0
    boundary = whole.boundary()
    check_closed(boundary, whole.points, "mesh")
    for normal in sector.inward:  # a face left on a plane would be a slit
        assert not (np.abs(whole.points[boundary] @ normal).max(axis=1) < 1e-9).any()
    assert whole.volume() == pytest.approx(surface.volume(), rel=0.05)
    find_cavities(whole, robot, "mesh")


def test_samples_are_symmetric(sector, configure, robot) -> None:
    for config in (configure(), configure(profile="tiny")):
        points = read_sample(config.geometry, config.of_tripod(), robot).points
        assert max(image_error(points, image) for image in sector.images) < 1e-6


def test_solids_without_the_symmetry_are_meshed_whole(surface, robot) -> None:
    pulled = surface.points + np.where(surface.points[:, :1] > 0.02, [[0.005, 0.0, 0.0]], 0.0)
    assert sector_of(Surface(pulled, surface.triangles), robot) is None
    assert sector_of(surface, dataclasses.replace(robot, chamber_angle_deg=(-90.0, -200.0, -330.0))) is None


PLANES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def test_flat_elements_are_dropped_and_leave_no_gap() -> None:
    # four corners of a thin quadrilateral at the plane y = 0, onto which all of them move, and two elements behind it
    points = np.array([[0.01, 1e-5, 0.0], [0.02, 0.0, 0.0], [0.02, 1e-5, 0.01], [0.01, 0.0, 0.01], [0.015, 0.01, 0.005]])
    part = tidy(points, np.array([[0, 2, 1, 3], [0, 2, 3, 4], [0, 1, 2, 4]]))
    planes = Sector(Surface(points, part.boundary()), PLANES, np.array([np.eye(3), np.diag([1.0, -1.0, 1.0])]))
    whole = whole_of(part, planes, 1e-3)
    check_closed(whole.boundary(), whole.points, "two pyramids")
    assert len(whole.corners) == 4
    assert whole.volume() == pytest.approx(2.0 * 0.01**3 / 3.0, rel=1e-6)


def test_crushed_elements_are_told() -> None:
    # the face moves up to its apex
    points = np.array([[0.01, -8e-4, 0.0], [0.02, -8e-4, 0.0], [0.01, -8e-4, 0.01], [0.015, 1e-10, 0.005]])
    part = tidy(points, np.array([[0, 1, 2, 3]]))
    with pytest.raises(MeshError, match="1 elements would be crushed"):
        whole_of(part, Sector(Surface(points, part.boundary()), PLANES, np.eye(3)[None]), 1e-3)
