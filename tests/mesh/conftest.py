"""The default robot and configuration, and bodies of little cubes whose volumes are known exactly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.core.config import build
from softrl.mesh.stage import Config
from softrl.mesh.tetrahedra import Tetrahedra, tidy
from softrl.robots.robot import Robot

CONF = Path(__file__).resolve().parents[2] / "conf"
# six tetrahedra around the diagonal of a cube; corner number = 4 x + 2 y + z
KUHN = np.array([[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]])


@pytest.fixture(scope="session")
def robot() -> Robot:
    return build(OmegaConf.to_container(OmegaConf.load(CONF / "robot" / "tripod.yaml")), Robot, "robot")


@pytest.fixture(scope="session")
def configure() -> Any:
    def make(*overrides: str, profile: str = "") -> Config:
        nodes = [OmegaConf.load(CONF / "profile" / profile / "mesh.yaml")] if profile else []
        base = OmegaConf.load(CONF / "stage" / "mesh.yaml")
        node = OmegaConf.merge(base, *nodes, OmegaConf.from_dotlist(list(overrides)))
        return build(OmegaConf.to_container(node), Config, "stage")

    return make


@pytest.fixture(scope="session")
def cubes() -> Any:
    def make(solid: np.ndarray, edge: float = 0.01) -> Tetrahedra:
        """Return the tetrahedra of the cells where ``solid`` (nx, ny, nz) holds, centred on the z axis."""
        shape = np.array(solid.shape) + 1
        points = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
        offset = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        corner = np.argwhere(solid)[:, None] + offset
        number = np.ravel_multi_index(tuple(np.moveaxis(corner, -1, 0)), tuple(shape))
        centred = points - np.array([solid.shape[0] / 2, solid.shape[1] / 2, 0])
        return tidy(edge * centred, number[:, KUHN].reshape(-1, 4))

    return make


@pytest.fixture
def block() -> np.ndarray:
    """Cells of a block with room for three cavities at the tripod's angles around the z axis."""
    return np.ones((11, 11, 5), bool)


def hollow(block: np.ndarray, *cells: tuple[int, int]) -> np.ndarray:
    made = block.copy()
    for x, y in cells:
        made[x, y, 1:4] = False
    return made


# towards -90, 150 and 30 degrees, which are the tripod's -90, -210 and -330
THREE = ((5, 1), (2, 7), (8, 7))
