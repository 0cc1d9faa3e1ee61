"""Robot, lumped body and rigs that the tests of this room share."""

from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build, build_target
from softrl.core.driver import Sample
from softrl.core.errors import DriverError
from softrl.core.simulator import Simulator
from softrl.core.tracking import NullTracker
from softrl.effects.chain import chain_of
from softrl.effects.effect import Effect
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint
from softrl.sim2real.drivers.regulator import Regulator
from softrl.sim2real.drivers.rig import Hardware, Noise, Rig, sample_of
from softrl.sim2real.drivers.stub import Ground
from softrl.sim2real.stage import Config
from softrl.sim2real.surface import Surface
from softrl.surrogate.stage import Config as SurrogateConfig
from softrl.surrogate.stage import build_surrogate
from softrl.surrogate.stiffness import Poses
from tests.sim2real.line import Line

CONF = Path(__file__).parents[2] / "conf"


@pytest.fixture(scope="session")
def tripod() -> Robot:
    """Return the default robot."""
    return build(yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text()), Robot, "robot")


@pytest.fixture(scope="session")
def body(tripod: Robot) -> Simulator:
    """Return the lumped body of the default robot."""
    node = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    return build_target(node, "simulator", lambda hint: tripod if hint is Robot else None)


@pytest.fixture(scope="session")
def silence() -> Noise:
    """Return sensors that report the truth."""
    return Noise(
        position_white_mm=0.0, position_coloured_mm=0.0, colour_s=1.0, orientation_white_deg=0.0,
        pressure_white_kpa=0.0, force_white_n=0.0, dropped_share=0.0,
    )  # fmt: skip


@pytest.fixture
def line(tripod: Robot, body: Simulator, silence: Noise) -> Line:
    """Return a line to a device on the lumped body."""
    return Line(Regulator(Hardware(body, chain_of(tripod, []), silence, 100.0, 100.0, 0.08), 0))


class BenchDriver:
    """The driver contract over a rig in the same process: as the stub, without starting processes."""

    def __init__(
        self, robot: Robot, body: Simulator, noise: Noise, effects: tuple[Effect, ...] = (), seed: int = 0
    ) -> None:
        self.robot = robot
        self.hardware = Hardware(body, chain_of(robot, effects), noise, 100.0, 200.0, watchdog_s=2.0)
        self.seed = seed
        self.entries = 0
        self.connected = False
        self.stale_s = 0.2
        self.samples: list[Sample] = []
        self.surface: Surface | None = None

    def mount(self, normal: np.ndarray, point: np.ndarray) -> None:
        self.surface = Ground(3000.0, 0.2, 0.2).mounted(normal, point)

    def cut(self, chamber: int | None) -> None:
        self.rig.cut(chamber)

    def __enter__(self) -> Self:
        self.rig = Rig(self.hardware, (self.seed, self.entries), self.surface)
        self.setpoint, self.due = Setpoint(self.robot, 0.01), 0.0
        self.entries += 1
        self.connected = True
        self.samples = []
        return self

    def __exit__(self, *exception: object) -> None:
        self.connected = False

    def command(self, pressure: np.ndarray) -> np.ndarray:
        assert self.connected, "command outside of the driver's with block"
        return self.setpoint.request(pressure)

    def advance(self, dt_s: float) -> list[Sample]:
        self.due += dt_s / 0.01
        ticks = int(self.due + 1e-6)
        self.due -= ticks
        rows, fault = self.rig.advance(ticks, self.setpoint.advance(ticks))
        assert fault is None
        arrived = [sample_of(row) for row in rows]
        self.samples += arrived
        return arrived

    def stop(self) -> None:
        raise DriverError("emergency stop")

    def release(self) -> None:
        pass


@pytest.fixture(scope="session")
def surrogate(tripod: Robot, body: Simulator) -> Surrogate:
    """Return a small surrogate of the lumped body."""
    return surrogate_of(tripod, body)


def surrogate_of(robot: Robot, body: Simulator) -> Surrogate:
    """Return a small surrogate of a body."""
    node = _profile("surrogate", "tiny") | {"links": 6, "seed": 0}
    rest = body.reset()

    def poses(loads: np.ndarray) -> Poses:
        # one implicit step this long is an equilibrium
        settled = (body.step(rest, row[:-3], 1e6, row[-3:]) for row in loads)
        return Poses(np.stack([body.observe(state)[0] for state in settled]), None)

    return build_surrogate(build(node, SurrogateConfig, "stage"), robot, None, poses, robot.length_m, NullTracker())


@pytest.fixture(scope="session")
def policy(surrogate: Surrogate) -> Policy:
    """Return one linear layer that sends the next target to the joints nearest to it, fitted on the samples."""
    space = Workspace(surrogate)
    low, high = surrogate.joint_low, surrogate.joint_high
    target = (surrogate.sample_tip - space.centre) / space.scale
    action = 2.0 * (surrogate.sample_joints - low) / (high - low) - 1.0
    inputs = np.hstack([target, np.ones((len(target), 1))])
    gain = np.linalg.lstsq(inputs, action, rcond=None)[0]
    weight = np.zeros((3, 15))
    weight[:, 7:10] = gain[:3].T
    return Policy(
        weights={"weight_0": weight, "bias_0": gain[3]}, activation="tanh", squash="clip", horizon=2,
        position_centre=space.centre, position_scale=space.scale, force_scale=1.0, joint_low=low, joint_high=high,
        task_name="track", task=task_numbers("track"), agent_name="linear", step_s=0.5, metrics={},
        robot_name=surrogate.robot_name,
    )  # fmt: skip


def task_numbers(name: str) -> dict[str, Any]:
    """Return the numbers of a task as its configuration has them."""
    node = yaml.safe_load((CONF / "task" / f"{name}.yaml").read_text()) | {"alpha": 0.5}
    return {key: value for key, value in node.items() if key != "_target_"}


@pytest.fixture(scope="session")
def calibration(tripod: Robot) -> Calibration:
    """Return a map that says the robot's pressures are the simulator's."""
    n, hidden = tripod.chambers, 2
    weights = {
        "skip": np.zeros((2, n, n)), "bias": np.zeros((2, n)), "weight_0": np.zeros((2, n, hidden)),
        "bias_0": np.zeros((2, hidden)), "weight_1": np.zeros((2, hidden, hidden)), "bias_1": np.zeros((2, hidden)),
        "weight_2": np.zeros((2, hidden, n)),
    }  # fmt: skip
    pairs, limit = np.zeros((4, n)), np.full(n, 35e3)
    return Calibration(
        weights=weights, members=2, pressure_mean=np.zeros(n), pressure_spread=limit, correction_spread=np.ones(n),
        pressure_low=-limit, pressure_high=limit, pressure_real=pairs, pressure_sim=pairs,
        heldout=np.zeros(4, dtype=bool), inverted_by="simulator", material={}, robot_name=tripod.name,
    )  # fmt: skip


def _profile(stage: str, profile: str) -> dict[str, Any]:
    """Return a stage's configuration with a profile's overrides."""
    base, over = (OmegaConf.load(CONF / part / f"{stage}.yaml") for part in ("stage", f"profile/{profile}"))
    base.seed = 0
    return cast(dict[str, Any], OmegaConf.to_container(OmegaConf.merge(base, over)))


@pytest.fixture(scope="session")
def config() -> Config:
    """Return the stage's configuration as ``profile=tiny`` composes it."""
    return build(_profile("sim2real", "tiny"), Config, "stage")
