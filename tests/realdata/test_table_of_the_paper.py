"""The full model on the authors' own surface against their table of pressures and tips: modulus, frame, and what limits it."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from softrl.calibration.table_fit import body_map, fit_table
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.fem.continuation import Equilibrium, follow
from softrl.fem.material import material_of
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import load_scale, paths
from softrl.mesh.stage import Config, run
from softrl.robots.robot import Robot
from softrl.robots.symmetry import symmetries
from tests.diagnosis.conftest import node

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("SOFTRL_REAL_DATA", ROOT.parent / "shared" / "data")) / "paper_manipulator"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.realdata,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"no real data at {DATA}"),
]
MODULUS_PA, EDGE_M, ENVELOPE_M = 2e6, 0.025, 0.0012
SAMPLES, RANGE_PA = 16, (-2e4, 3.4e4)
ROWS = 2000
NEWTON = NewtonSettings(1e-7, 40, 0.3)


def surface_mesh(robot: Robot) -> Any:
    path = DATA / "ManipulatorWhole25.stl"
    base = OmegaConf.load(ROOT / "conf" / "stage" / "mesh.yaml")
    own = OmegaConf.from_dotlist([f"source={path}", f"tetrahedra.edge_m={EDGE_M}", f"tetrahedra.envelope_m={ENVELOPE_M}"])
    settings = build(OmegaConf.to_container(OmegaConf.merge(base, own)), Config, "stage")
    return run(settings, robot, tracker=NullTracker())


def equilibria(model: FemModel, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pressures (S, 3) Pa, tip displacements (S, 3) m and the plate's rotation vectors, those of all turns of the body."""
    unit = qmc.Sobol(3, rng=np.random.default_rng(0)).random(SAMPLES)
    loads = np.hstack([RANGE_PA[0] + np.ptp(RANGE_PA) * unit, np.zeros((SAMPLES, 3))])
    scale = load_scale(robot)
    found = [e for e in follow(model, loads[paths(loads, scale, 1)[0]], scale, 0.8) if isinstance(e, Equilibrium)]
    tip = np.array([model.coordinate(e.pose)[-3:] for e in found])
    spin = np.array([Rotation.from_quat(model.tip_quaternion(e.pose), scalar_first=True).as_rotvec() for e in found])
    pressure = np.array([e.load[:3] for e in found])
    turned = [
        (pressure @ image.coordinate[:3, :3].T, tip @ image.vector.T, spin @ image.vector.T)
        for image in symmetries(robot.chamber_direction)
        if np.linalg.det(image.vector) > 0.0
    ]
    pressures, tips, spins = (np.vstack(column) for column in zip(*turned, strict=True))
    return pressures, tips, spins


def test_a_reach_beyond_the_plate_explains_more_of_the_table_than_the_modulus() -> None:
    """Prints the errors that experiments/table_of_the_paper.md discusses: run with -s."""
    robot = build(node("robot/tripod.yaml"), Robot, "robot")
    mesh = surface_mesh(robot)
    material = material_of("stable_neo_hookean", (MODULUS_PA,), 0.45)
    model = FemModel(mesh, material, robot.mass_kg / mesh.volume(), 0.0, 0.0, NEWTON)
    pressure, tip, spin = equilibria(model, robot)
    assert len(pressure) >= 3 * (SAMPLES - 2), "equilibria were missed"
    body, error_m = body_map(pressure, tip, MODULUS_PA, 3, spin)
    table = np.loadtxt(DATA / "Pressure_vs_Pos.csv", delimiter=",", skiprows=1)
    rng = np.random.default_rng(0)
    rows = table[rng.choice(len(table), ROWS, replace=False)]
    train = np.arange(ROWS) < ROWS // 2
    plain, reaching = (fit_table(body, 1e3 * rows[:, :3], rows[:, 3:], train, seek) for seek in (False, True))
    print(f"\nbody's own map, cross-validated: {1e3 * error_m:.1f} mm; the tip never moves: {1e3 * plain.still_rmse_m:.1f} mm")
    for name, fit in (("modulus and frame", plain), ("and a reach", reaching)):
        print(
            f"{name}: held out {1e3 * fit.heldout_rmse_m:.1f} mm, fitted {1e3 * fit.train_rmse_m:.1f} mm, "
            f"E {1e-6 * fit.youngs_modulus_pa:.2f} MPa, reach {1e3 * fit.reach_m:.0f} mm"
        )
    assert plain.heldout_rmse_m < 0.2 * plain.still_rmse_m
    assert reaching.heldout_rmse_m < 0.7 * plain.heldout_rmse_m
    assert reaching.heldout_rmse_m < 0.0045 and 0.02 < reaching.reach_m < 0.06
