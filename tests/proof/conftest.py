from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.core.config import build
from softrl.proof.generator.plant import Body
from softrl.proof.stage import Config
from softrl.robots.robot import Robot

CONF = Path(__file__).resolve().parents[2] / "conf"


def loaded(path: str) -> dict[str, Any]:
    found = OmegaConf.to_container(OmegaConf.load(CONF / path))
    assert isinstance(found, dict)
    return {str(key): value for key, value in found.items()}


def configured(**overrides: Any) -> Config:
    base = loaded("stage/proof.yaml")
    del base["defaults"]
    base["diagnosis"] = OmegaConf.merge(
        {"diagnosis": loaded("stage/diagnosis.yaml")}, {"diagnosis": base["diagnosis"]}
    )["diagnosis"]
    small = {"seed": 0, "diagnosis": {"seed": 0}}
    merged: Any = OmegaConf.to_container(OmegaConf.merge(base, loaded("profile/tiny/proof.yaml"), small, overrides))
    return build(merged, Config, "stage")


@pytest.fixture(scope="session")
def tripod() -> Robot:
    return build(loaded("robot/tripod.yaml"), Robot, "robot")


def body_of(robot: Robot, **changed: Any) -> Body:
    numbers: dict[str, Any] = {
        "direction": robot.chamber_direction,
        "radius_m": robot.chamber_radius_m,
        "area_m2": robot.chamber_area_m2,
        "length_m": robot.length_m,
        "mass_kg": robot.mass_kg,
        "pressure_pa": robot.pressure_max_pa,
        "bending_j": 2.9,
        "axial_j": 185.0,
        "damping_s": 0.05,
        "gravity": np.array(robot.gravity_m_s2),
        "links": 6,
    }
    return Body(**(numbers | changed))
