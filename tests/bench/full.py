"""The full model of a test's mesh with the settings that conf/ gives it."""

from pathlib import Path

from omegaconf import OmegaConf

from softrl.artifacts.mesh import Mesh
from softrl.core.config import UNFILLED, build_target
from softrl.fem.simulator import FemSimulator
from softrl.robots.robot import Robot


def full_simulator(robot: Robot, mesh: Mesh, **changes: object) -> FemSimulator:
    """Return the full model of ``mesh`` as conf/simulator/fem.yaml has it but for ``changes``, in rubber of 1 MPa."""
    conf = Path(__file__).resolve().parents[2] / "conf" / "simulator" / "fem.yaml"
    node = OmegaConf.to_container(OmegaConf.load(conf))
    assert isinstance(node, dict)
    inputs = {Robot: robot, Mesh: mesh}
    return build_target(node | {"moduli_pa": [1e6]} | changes, "simulator", lambda hint: inputs.get(hint, UNFILLED))
