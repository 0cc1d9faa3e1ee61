"""The URDF of the chain as text: what PyBullet, or any other rigid-body program, loads."""

import numpy as np

from softrl.surrogate.dimensions import Dimensions

HINGE_MASS_KG = 1e-3  # the two hinges of a gap need links of their own, whose mass is part of the total
HINGE_SHARE = 0.2  # of a gap's mass, at most: that of a light robot is in its planes as well
EFFORT, VELOCITY = 1e4, 1e2


def write_urdf(
    name: str, dimensions: Dimensions, mass: float, joint_low: np.ndarray, joint_high: np.ndarray, tip_radius: float
) -> str:
    """Return the URDF of a chain whose planar links share ``mass`` kg.

    Parameters
    ----------
    joint_low, joint_high : (3,) rad, rad, m, limits of every gap's joints
    tip_radius : m, of the sphere about the tip with which it touches surfaces
    """
    d = dimensions
    gaps = len(d.plane_height)
    hinge_mass = min(HINGE_MASS_KG, HINGE_SHARE * mass / gaps)
    share = mass / gaps - 2.0 * hinge_mass
    pitch = float(np.diff(d.plane_height, prepend=0.0).mean())
    parts = [_link("base", share, d.plane_radius[0], d.joint_height[0] * 0.5, 0.25 * d.joint_height[0])]
    parent, below = "base", 0.0
    for k in range(gaps):
        hinge, plane = d.joint_height[k], d.plane_height[k]
        parts += [
            _hinge(f"hinge_x_{k}", hinge_mass), _hinge(f"hinge_y_{k}", hinge_mass),
            _link(f"plane_{k}", share, d.plane_radius[k], 0.2 * pitch, 0.0),
            _joint(f"theta_x_{k}", "revolute", parent, f"hinge_x_{k}", hinge - below, "1 0 0", joint_low[0], joint_high[0]),
            _joint(f"theta_y_{k}", "revolute", f"hinge_x_{k}", f"hinge_y_{k}", 0.0, "0 1 0", joint_low[1], joint_high[1]),
            _joint(f"slide_{k}", "prismatic", f"hinge_y_{k}", f"plane_{k}", plane - hinge, "0 0 1", joint_low[2], joint_high[2]),
        ]  # fmt: skip
        parent, below = f"plane_{k}", plane
    parts += [_tip(tip_radius, hinge_mass), f'<joint name="tip_mount" type="fixed"><origin xyz="0 0 {d.tip_height - below:.9g}"/>'
              f'<parent link="{parent}"/><child link="tip"/></joint>']  # fmt: skip
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n' + "\n".join(parts) + "\n</robot>\n"


def _link(name: str, mass: float, radius: float, thickness: float, centre: float) -> str:
    across = mass * (3.0 * radius**2 + thickness**2) / 12.0
    shape = (f'<origin xyz="0 0 {centre:.9g}"/><geometry><cylinder radius="{radius:.9g}" length="{thickness:.9g}"/>'
             "</geometry>")  # fmt: skip
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {centre:.9g}"/><mass value="{mass:.9g}"/>'
        f"{_inertia(across, 0.5 * mass * radius**2)}</inertial>"
        f"<visual>{shape}</visual><collision>{shape}</collision></link>"
    )


def _hinge(name: str, mass: float) -> str:
    # as a ball of 10 mm radius
    inertia = 0.4 * mass * 0.01**2
    return f'<link name="{name}"><inertial><mass value="{mass:.9g}"/>{_inertia(inertia, inertia)}</inertial></link>'


def _tip(radius: float, mass: float) -> str:
    inertia = 0.4 * mass * 0.01**2
    ball = f'<geometry><sphere radius="{radius:.9g}"/></geometry>'
    return (
        f'<link name="tip"><inertial><mass value="{mass:.9g}"/>{_inertia(inertia, inertia)}</inertial>'
        f"<visual>{ball}</visual><collision>{ball}</collision></link>"
    )


def _inertia(across: float, along: float) -> str:
    return f'<inertia ixx="{across:.6g}" iyy="{across:.6g}" izz="{along:.6g}" ixy="0" ixz="0" iyz="0"/>'


def _joint(name: str, kind: str, parent: str, child: str, height: float, axis: str, low: float, high: float) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0 0 {height:.9g}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/><dynamics damping="0" friction="0"/>'
        f'<limit effort="{EFFORT:g}" velocity="{VELOCITY:g}" lower="{low:.9g}" upper="{high:.9g}"/></joint>'
    )
