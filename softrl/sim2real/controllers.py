"""The controllers that a rollout compares, made from what earlier stages left."""

from dataclasses import dataclass, replace

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.effects.chain import Plant
from softrl.robots.robot import Robot
from softrl.sim2real.controller import Calibrated, ModelController, PolicyController
from softrl.sim2real.planning import PlannedController, Planning, Route, plan
from softrl.sim2real.rollout import Controller, Pace


@dataclass(frozen=True)
class Models:
    """What is known of the robot.

    Attributes
    ----------
    plant : the simulator, nominal or with what a diagnosis found
    """

    robot: Robot
    policy: Policy
    surrogate: Surrogate
    calibration: Calibration
    plant: Plant

    @property
    def corrected(self) -> bool:
        """Whether the simulator has effects: then it takes the robot's own pressures, f_RS was for the nominal one."""
        return bool(self.plant.chain.effects)


def controllers(models: Models, planning: Planning, pace: Pace, target: np.ndarray) -> dict[str, Controller]:
    """Return the controllers of one sequence of targets (steps, 3) m by name.

    ``policy`` and ``planned`` see the tip; ``feedforward`` and ``open_loop`` do not. ``open_loop`` is the surrogate's static
    inverse, ``feedforward`` that of the simulator in motion.
    """
    open_loop = ModelController(models.surrogate, target)
    route = Route(models.robot, models.plant, pace.period_s, planning.dt_s, pace.average_window, _position)
    prepared = plan(route, target, open_loop.pressures, pace.approach_steps, planning)

    def planned(settings: Planning) -> Controller:
        made = PlannedController(prepared, pace.approach_steps, settings, models.robot, _position)
        return made if models.corrected else Calibrated(made, models.calibration)

    return {
        "policy": PolicyController(models.policy, models.surrogate, models.calibration, target),
        "open_loop": open_loop,
        "feedforward": planned(replace(planning, feedback=0.0)),
        "planned": planned(planning),
    }


def _position(position: np.ndarray, tip_force: np.ndarray | None = None) -> np.ndarray:
    return position
