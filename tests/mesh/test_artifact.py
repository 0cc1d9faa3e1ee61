"""A mesh that was made elsewhere is checked before a stage takes it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import ArtifactError
from tests.fem.bodies import hollow_box

BOX = hollow_box(chambers=2)


def without(triangles: np.ndarray) -> Mesh:
    return replace(BOX, cavity_triangles=BOX.cavity_triangles[~triangles], cavity_of_triangle=BOX.cavity_of_triangle[~triangles])


def test_a_whole_mesh_comes_back(tmp_path: Path) -> None:
    BOX.save(tmp_path / "mesh")
    assert np.array_equal(Mesh.load(tmp_path / "mesh").cavity_triangles, BOX.cavity_triangles)


def test_a_cavity_that_encloses_nothing_is_refused() -> None:
    hole = np.arange(len(BOX.cavity_triangles)) == np.flatnonzero(BOX.cavity_of_triangle == 1)[0]
    with pytest.raises(ArtifactError, match="cavity 2 of box is open"):
        without(hole).validate()
    turned = np.where(hole[:, None], BOX.cavity_triangles[:, ::-1], BOX.cavity_triangles)
    with pytest.raises(ArtifactError, match="cavity 2 of box is open, or its triangles disagree"):
        replace(BOX, cavity_triangles=turned).validate()
    with pytest.raises(ArtifactError, match="cavity 1 of box encloses no positive volume"):
        replace(BOX, cavity_triangles=BOX.cavity_triangles[:, ::-1]).validate()


@pytest.mark.parametrize("part", ["node_region", "element_layer", "cavity_of_triangle"])
def test_lengths_agree(part: str) -> None:
    with pytest.raises(ArtifactError, match=f"{part} holds .* values; expected"):
        replace(BOX, **{part: getattr(BOX, part)[:-1]}).validate()


@pytest.mark.parametrize("name", ["tetrahedra", "cavity_triangles"])
@pytest.mark.parametrize("shift", [-1, 1])
def test_numbers_are_those_of_nodes(name: str, shift: int) -> None:
    with pytest.raises(ArtifactError, match=f"{name} name nodes -?[0-9]+ to -?[0-9]+; expected 0 to {len(BOX.points) - 1}"):
        replace(BOX, **{name: getattr(BOX, name) + shift * len(BOX.points)}).validate()
