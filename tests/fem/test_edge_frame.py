"""The body in edge frames against the law it shares, and against what SOFA itself computed."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import PLATE, Mesh
from softrl.fem.edge_frame import EdgeFrameBody
from softrl.fem.material import Corotational
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from tests.fem.bodies import model_of

MODULUS_PA, POISSON, MASS_KG, DAMPING_S, DT_S = 3e6, 0.41, 1.10, 0.05, 0.01
STEADY, DYNAMIC = "steady_rigid_ribs_own_cavities.csv", "dynamic_rigid_ribs_own_cavities.csv"


def test_it_agrees_with_the_polar_frame_to_second_order_in_strain(box: Mesh) -> None:
    polar = model_of(box, Corotational(1e6, 0.4), element_order=1)
    edge = EdgeFrameBody(box, 1e6, 0.4, polar.nodal_mass, 0.0)
    apart, moved = [], []
    for pressure in (500.0, 1000.0):
        one = polar.static(np.r_[pressure, np.zeros(4)]).pose.position
        two = edge.static(np.array([pressure, 0.0]), edge.rest().pose, 1e-10, 200).position
        apart.append(np.abs(one - two).max())
        moved.append(np.abs(one - box.points).max())
    assert apart[1] < 0.05 * moved[1]
    assert 3.0 < apart[1] / apart[0] < 5.0


def test_turning_a_body_makes_no_force(box: Mesh) -> None:
    edge = EdgeFrameBody(box, 1e6, 0.4, np.ones(len(box.points)), 0.0)
    turn = Rotation.from_rotvec([0.5, -1.0, 0.3]).as_matrix()
    rest = edge.rest().pose
    turned = type(rest)(rest.position @ turn.T, rest.centre, rest.rotation)
    force, _ = edge._force_and_stiffness(turned, np.zeros(2))
    assert np.abs(force).max() < 1e-9


def reference(folder: Path) -> Mesh:
    """Return SOFA's mesh with its own cavity surfaces, turned so that their normals point into the cavity."""
    with np.load(folder / "model.npz", allow_pickle=False) as data:
        cavities = [data[f"cavity{k}_triangles"][:, ::-1] for k in (1, 2, 3)]
        tetrahedra = data["tets"]
        return Mesh(
            1e-3 * data["points_mm"],
            tetrahedra,
            data["region"],
            np.zeros(len(tetrahedra), int),
            np.concatenate(cavities),
            np.repeat(np.arange(3), [len(c) for c in cavities]),
            "sofa",
        )


def table(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return pressures (rows, 3) Pa and plate means (rows, 3) m."""
    rows = np.genfromtxt(path, delimiter=",", names=True)
    pressure = np.stack([rows[f"p{k}_kpa"] for k in (1, 2, 3)], axis=1)
    tip = np.stack([rows[f"plate_mean_{axis}_mm"] for axis in "xyz"], axis=1)
    return 1e3 * pressure, 1e-3 * tip


@pytest.fixture(scope="module")
def sofa(real_data: Path) -> tuple[Path, Mesh, EdgeFrameBody]:
    folder = real_data / "sofa_reference"
    mesh = reference(folder)
    mass = np.full(len(mesh.points), MASS_KG / len(mesh.points))
    return folder, mesh, EdgeFrameBody(mesh, MODULUS_PA, POISSON, mass, DAMPING_S)


@pytest.mark.realdata
def test_steady_tips_are_those_of_sofa(sofa: tuple[Path, Mesh, EdgeFrameBody]) -> None:
    folder, mesh, body = sofa
    pressure, tip = table(folder / STEADY)
    rest, plate, worst = tip[0], mesh.node_region == PLATE, 0.0
    for row, wanted in zip(pressure[1:], tip[1:], strict=True):
        found = body.static(row, body.rest().pose, 1e-8, 100).position[plate].mean(axis=0)
        worst = max(worst, float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted - rest)))
    assert worst < 1e-4, f"{100 * worst:.4f} % of the motion"


@pytest.mark.realdata
def test_the_motion_under_steps_of_pressure_is_that_of_sofa(sofa: tuple[Path, Mesh, EdgeFrameBody]) -> None:
    folder, mesh, body = sofa
    pressure, tip = table(folder / DYNAMIC)
    plate, motion, found = mesh.node_region == PLATE, body.rest(), []
    for row in pressure:
        motion = body.step(motion, row, DT_S)
        found.append(motion.pose.position[plate].mean(axis=0))
    apart, moved = np.linalg.norm(found - tip, axis=1).max(), np.linalg.norm(tip - tip[0], axis=1).max()
    assert apart < 5e-4 * moved, f"{100 * apart / moved:.3f} % of the motion"


@pytest.mark.realdata
def test_the_energy_model_with_linear_tetrahedra_differs_from_sofa_by_its_frame_only(
    sofa: tuple[Path, Mesh, EdgeFrameBody],
) -> None:
    # the polar frame against the edge frame: second order in strain, so it grows with the square of the pressure
    folder, mesh, _ = sofa
    pressure, tip = table(folder / STEADY)
    density = MASS_KG / mesh.volume()
    model = FemModel(
        mesh, Corotational(MODULUS_PA, POISSON), density, 0.0, DAMPING_S, NewtonSettings(1e-8, 40, 0.3), element_order=1
    )
    plate, chosen = mesh.node_region == PLATE, [1, 3, 4, 6, 20, 22, 24, 27, 31, 34]
    moved = np.array(
        [model.static(np.r_[row, np.zeros(3)]).pose.position[plate].mean(axis=0) - tip[0] for row in pressure[chosen]]
    )
    wanted = tip[chosen] - tip[0]
    share = np.sqrt(((moved - wanted) ** 2).sum() / (wanted**2).sum())
    assert share < 0.01, f"{100 * share:.2f} % of the motion"
