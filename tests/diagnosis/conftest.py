"""Recordings of a lumped body with hidden physics, made through the same plant that people use."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation

from softrl.core.config import build
from softrl.diagnosis.stage import Config
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.program import multisine, random_steps, triangles
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

CONF = Path(__file__).resolve().parents[2] / "conf"
Maker = Callable[..., RecordingSet]


def node(path: str) -> dict[str, Any]:
    found = OmegaConf.to_container(OmegaConf.load(CONF / path))
    assert isinstance(found, dict)
    return {str(key): value for key, value in found.items() if key != "_target_"}


def configured(**overrides: Any) -> Config:
    base = OmegaConf.load(CONF / "stage/diagnosis.yaml")
    quick = {"seed": 0, "search": {"workers": 1}}
    merged: Any = OmegaConf.to_container(OmegaConf.merge(base, quick, overrides))
    return build(merged, Config, "stage")


@pytest.fixture(scope="session")
def tripod() -> Robot:
    return build(node("robot/tripod.yaml"), Robot, "robot")


@pytest.fixture(scope="session")
def body(tripod: Robot) -> PccSimulator:
    return PccSimulator(robot=tripod, **node("simulator/pcc.yaml"))


def programs(robot: Robot, rng: np.random.Generator, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
    chamber = int(rng.integers(robot.chambers))
    parts = [
        random_steps(robot, 5, 2.0, dt_s, rng)[1],
        multisine(robot, 8.0, (0.1, 3.0), 0.8, dt_s, rng)[1],
        np.zeros((round(1.0 / dt_s), robot.chambers)),
        triangles(robot, chamber, robot.pressure_max_pa, (1.0, 4.0), 1, dt_s)[1],
    ]
    pressure = np.concatenate(parts)
    return dt_s * np.arange(1, len(pressure) + 1), pressure


def made(
    simulator: Any,
    effects: tuple[Effect, ...] = (),
    *,
    seed: int = 0,
    sessions: int = 5,
    noise_m: float = 1e-4,
    measured: bool = False,
    period_s: float = 0.02,
    warmth: Callable[[int, np.ndarray], np.ndarray] | None = None,
    process: Callable[[Recording], Recording] | None = None,
) -> RecordingSet:
    """Return sessions of one run each, with white noise; ``process`` changes a run after its simulation.

    ``warmth`` (number, time) is the temperature along a run, degree Celsius.
    """
    robot, rng = simulator.robot, np.random.default_rng(seed)
    plant = Plant(simulator, chain_of(robot, effects))
    runs = []
    for number in range(sessions):
        time, pressure = programs(robot, rng, period_s)
        temperature = None if warmth is None else warmth(number, time)
        blank = Recording(f"run_{number}", f"day_{number}", time, pressure, temperature=temperature)
        run = replace(replay(plant, blank, 0.01), temperature=temperature)
        if process is not None:
            run = process(run)
        assert run.position is not None and run.quaternion is not None and run.pressure_meas is not None
        turned = Rotation.from_rotvec(3e-4 * rng.standard_normal((len(time), 3))) * Rotation.from_quat(
            run.quaternion, scalar_first=True
        )
        angle = run.bend_angle
        runs.append(
            replace(
                run,
                position=run.position + noise_m * rng.standard_normal((len(time), 3)),
                quaternion=turned.as_quat(scalar_first=True),
                pressure_meas=run.pressure_meas + 50.0 * rng.standard_normal(pressure.shape) if measured else None,
                bend_angle=None if angle is None else angle + 2e-3 * rng.standard_normal(len(time)),
            )
        )
    return RecordingSet(robot_name=robot.name, recordings=tuple(runs))
