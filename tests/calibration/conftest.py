"""A robot in the process: the driver contract over any simulator, with a known error of its pressures."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

import numpy as np
import pytest

from softrl.core.driver import Sample
from softrl.core.simulator import Simulator
from softrl.pcc.simulator import PccSimulator
from softrl.robots.robot import Robot

RATE_S = 0.02


def weak_regulator(pressure: np.ndarray) -> np.ndarray:
    """Return what acts (.., 3) Pa at a command: another gain per chamber, and less of it at high pressure."""
    return pressure * np.array([0.90, 0.95, 1.04]) - 2.0e-6 * pressure**2 + 300.0


@dataclass
class FakeDriver:
    """Steps ``body`` in the process; ``acting`` maps the command to the pressure in the chambers."""

    body: Simulator
    chambers: int
    acting: Callable[[np.ndarray], np.ndarray]
    noise_m: float = 0.0
    connected: bool = False
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(3))
    samples: list[Sample] = field(default_factory=list)

    def __enter__(self) -> Self:
        self.state, self.time_s, self.connected = self.body.reset(), 0.0, True
        self.sent, self.samples = np.zeros(self.chambers), []
        return self

    def __exit__(self, *exception: object) -> None:
        self.connected = False

    def command(self, pressure: np.ndarray) -> np.ndarray:
        assert self.connected, "command outside of the driver's with block"
        self.sent = np.array(pressure)
        return self.sent

    def advance(self, dt_s: float) -> list[Sample]:
        self.state = self.body.step(self.state, self.acting(self.sent), dt_s)
        self.time_s += dt_s
        position, quaternion = self.body.observe(self.state)
        position = position + self.noise_m * self.rng.standard_normal(3)
        self.samples.append(Sample(self.time_s, self.sent, self.sent, position, quaternion, np.zeros(3)))
        return self.samples[-1:]


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="triple", chamber_angle_deg=(-90.0, -210.0, -330.0), chamber_radius_m=0.05, chamber_area_m2=1e-3,
        length_m=0.18, mass_kg=0.6, pressure_min_pa=-20e3, pressure_max_pa=35e3, slew_pa_per_s=4e5, tip_force_max_n=2.0,
        axis="+z", output="tip_pose", command="pressure", command_to_pa=1.0, gravity_m_s2=(0.0, 0.0, -9.81),
    )  # fmt: skip


@pytest.fixture(scope="session")
def body(robot: Robot) -> PccSimulator:
    return PccSimulator(
        robot, bend_at_full_pressure_rad=0.7, elongation_at_full_pressure=0.2, bending_stiffness_scale=1.0,
        axial_stiffness_scale=1.0, damping_s=0.15, mass_scale=1.0,
    )  # fmt: skip


@pytest.fixture(scope="session")
def acting() -> Callable[[np.ndarray], np.ndarray]:
    return weak_regulator


@pytest.fixture
def driver(robot: Robot, body: PccSimulator) -> FakeDriver:
    return FakeDriver(body, robot.chambers, weak_regulator)
