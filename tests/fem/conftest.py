"""Puts this folder's bodies within reach of its tests."""

import pytest

from softrl.artifacts.mesh import Mesh
from tests.fem.bodies import hollow_box


@pytest.fixture(scope="session")
def box() -> Mesh:
    """Return a box with two chambers."""
    return hollow_box(chambers=2)
