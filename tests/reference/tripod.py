"""The sample meshes of the tripod, made as the stage makes them."""

from pathlib import Path
from typing import Any

import yaml

from softrl.artifacts.mesh import Mesh
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.mesh.stage import Config, run
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


def robot() -> Robot:
    """Return the default robot."""
    return build(yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text()), Robot, "robot")


def sample_mesh(profile: str = "quick") -> Mesh:
    """Return the mesh of ``profile`` quick or tiny."""
    node: dict[str, Any] = yaml.safe_load((CONF / "stage" / "mesh.yaml").read_text())
    if profile != "quick":
        for key, value in yaml.safe_load((CONF / "profile" / profile / "mesh.yaml").read_text()).items():
            node[key] = node[key] | value if isinstance(value, dict) else value
    return run(build(node, Config, "stage"), robot(), tracker=NullTracker())
