"""The same chain built the paper's way, as a baseline: a link with its own mesh for every bulge, and joint motors."""

import math
import tempfile
from pathlib import Path

import numpy as np
import pybullet as bullet

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import SolverError
from softrl.robots.robot import Robot

RATE_HZ = 240.0
RINGS, SECTORS = 8, 16  # facets of a bulge's mesh
GAIN = 0.5  # of the joints' position motors
FORCE = 200.0  # N and N m that a motor may give
BULGE_MASS_KG = 0.01


class PaperStyleWorld:
    """A chain in a PyBullet server of its own, moved by position motors with PyBullet's own solver settings.

    Notes
    -----
    [Hong 2025] section 4: planar links with three joints a gap, bulges as links fixed to them. The paper's own file is not
    used: geometry, joints and masses are this surrogate's, so that both chains make the same motion. Inertia is that of
    the bodies, not the 0.3 kg m^2 of the paper's file.
    """

    def __init__(self, surrogate: Surrogate, robot: Robot) -> None:
        self._client = bullet.connect(bullet.DIRECT)
        if self._client < 0:
            raise SolverError("PyBullet gave no server; it allows a limited number per process, close other simulators")
        with tempfile.TemporaryDirectory() as folder:
            path = write_paper_style(surrogate, robot, Path(folder))
            self.body = int(bullet.loadURDF(str(path), useFixedBase=True, physicsClientId=self._client))
        count = bullet.getNumJoints(self.body, physicsClientId=self._client)
        kinds = [bullet.getJointInfo(self.body, i, physicsClientId=self._client) for i in range(count)]
        self.tip = next(i for i, info in enumerate(kinds) if info[1] == b"tip_mount")
        self.joints = [i for i, info in enumerate(kinds) if info[2] != bullet.JOINT_FIXED]
        self.links = count
        bullet.setTimeStep(1.0 / RATE_HZ, physicsClientId=self._client)

    def control_step(self, theta: np.ndarray, sub_steps: int) -> np.ndarray:
        """Return the tip (3,) m after ``sub_steps`` of simulation towards the grouped command ``theta`` (3,)."""
        for number, joint in enumerate(self.joints):
            bullet.setJointMotorControl2(
                self.body, joint, bullet.POSITION_CONTROL, targetPosition=float(theta[number % 3]), force=FORCE,
                positionGain=GAIN, physicsClientId=self._client,
            )  # fmt: skip
        for _ in range(sub_steps):
            bullet.stepSimulation(physicsClientId=self._client)
        read = bullet.getLinkState(self.body, self.tip, computeForwardKinematics=1, physicsClientId=self._client)
        return np.array(read[4])

    def close(self) -> None:
        """Give the server back."""
        bullet.disconnect(physicsClientId=self._client)


def write_paper_style(surrogate: Surrogate, robot: Robot, folder: Path) -> Path:
    """Write the URDF, and the mesh that its bulges share, to ``folder``; return the URDF's path."""
    radius = max(0.25 * robot.chamber_radius_m, float(surrogate.plane_radius.mean()) - robot.chamber_radius_m)
    half = 0.5 * float(np.diff(surrogate.plane_height, prepend=0.0).mean())
    (folder / "bulge.obj").write_text(_bulge(radius, 0.45 * half))
    text = surrogate.urdf.replace("</robot>", "")
    for gap in range(surrogate.gaps):
        for chamber, angle in enumerate(np.deg2rad(robot.chamber_angle_deg)):
            x, y = robot.chamber_radius_m * math.cos(angle), robot.chamber_radius_m * math.sin(angle)
            text += _bulge_link(f"bulge_{gap}_{chamber}", f"plane_{gap}", x, y, -half, radius)
    path = folder / "paper_style.urdf"
    path.write_text(text + "</robot>\n")
    return path


def _bulge_link(name: str, parent: str, x: float, y: float, z: float, radius: float) -> str:
    inertia = 0.4 * BULGE_MASS_KG * radius**2
    shape = '<geometry><mesh filename="bulge.obj" scale="1 1 1"/></geometry>'
    return (
        f'<link name="{name}"><inertial><mass value="{BULGE_MASS_KG:g}"/><inertia ixx="{inertia:.6g}" '
        f'iyy="{inertia:.6g}" izz="{inertia:.6g}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<visual>{shape}</visual><collision>{shape}</collision></link>\n"
        f'<joint name="{name}_mount" type="fixed"><origin xyz="{x:.9g} {y:.9g} {z:.9g}"/><parent link="{parent}"/>'
        f'<child link="{name}"/></joint>\n'
    )


def _bulge(radius: float, half_height: float) -> str:
    """Return the mesh of a flattened ball as the text of an OBJ file."""
    lines = []
    for ring in range(RINGS + 1):
        polar = math.pi * ring / RINGS
        for sector in range(SECTORS):
            turn = 2.0 * math.pi * sector / SECTORS
            x, y = radius * math.sin(polar) * math.cos(turn), radius * math.sin(polar) * math.sin(turn)
            lines.append(f"v {x:.6f} {y:.6f} {half_height * math.cos(polar):.6f}")
    for ring in range(RINGS):
        for sector in range(SECTORS):
            a, b = ring * SECTORS + sector + 1, ring * SECTORS + (sector + 1) % SECTORS + 1
            lines.append(f"f {a} {b} {b + SECTORS} {a + SECTORS}")
    return "\n".join(lines) + "\n"
