"""The controllers that a rollout compares, made from what earlier stages left."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.effects.chain import EffectChain, Plant
from softrl.rl.inversion import Plan, Route, plan
from softrl.rl.tasks.task import Task
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.controller import Calibrated, ModelController, PolicyController
from softrl.sim2real.course import Course
from softrl.sim2real.planning import PlannedController, Planning
from softrl.sim2real.rollout import Controller, Pace
from softrl.sim2real.surface import Surface

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Models:
    """What is known of the robot.

    Attributes
    ----------
    space : what the surrogate's tip can reach
    task : what the policy was trained for
    plant : the simulator, nominal or with what a diagnosis found
    """

    robot: Robot
    policy: Policy
    space: Workspace
    task: Task
    calibration: Calibration
    plant: Plant

    @property
    def corrected(self) -> bool:
        """Whether the simulator has effects: then it takes the robot's own pressures, f_RS was for the nominal one."""
        return bool(self.plant.chain.effects)

    @cached_property
    def surface(self) -> Surface | None:
        """The task's surface, as stiff as the surrogate takes it to be."""
        plane = self.task.plane(self.space)
        if plane is None:
            return None
        (x, y, z), (a, b, c) = (tuple(map(float, values)) for values in plane)
        stiffness = self.space.surrogate.contact_stiffness_n_per_m
        return Surface((x, y, z), (a, b, c), float(stiffness), self.task.friction)

    @property
    def touching(self) -> Plant:
        """The plant with the surface."""
        chain = self.plant.chain
        if self.surface is None:
            return self.plant
        return Plant(self.plant.simulator, EffectChain(chain.robot, (*chain.effects, self.surface)))


def prepare(models: Models, planning: Planning, pace: Pace, course: Course) -> Plan:
    """Return the plan for a course: the simulator, with its effects and the task's surface, inverted."""
    surface = models.surface

    def simulated(position: np.ndarray) -> np.ndarray:
        force = np.zeros(len(position)) if surface is None else surface.normal_force(position)
        return course.readings(position, force)

    start = ModelController(models.space, models.task, course).pressures
    route = Route(models.robot, models.touching, pace.period_s, planning.dt_s, pace.average_window, simulated)
    prepared = plan(route, course.wanted, start, pace.approach_steps, planning)
    left = (prepared.predicted - prepared.target)[pace.approach_steps :]
    log.info("plan: %.3f mm rms from the targets in the simulation", 1e3 * np.sqrt(np.mean(np.sum(left**2, axis=1))))
    return prepared


def controllers(models: Models, planning: Planning, pace: Pace, course: Course, prepared: Plan) -> dict[str, Controller]:
    """Return fresh controllers of one course by name.

    ``policy`` and ``planned`` see the tip; ``feedforward`` and ``open_loop`` do not. ``open_loop`` is the surrogate's static
    inverse, ``feedforward`` that of the simulator in motion.
    """

    def measured(position: np.ndarray, tip_force: np.ndarray | None) -> np.ndarray:
        return course.readings(position, course.pressed(tip_force))

    def planned(settings: Planning) -> Controller:
        made = PlannedController(prepared, pace.approach_steps, settings, models.robot, measured)
        return made if models.corrected else Calibrated(made, models.calibration)

    return {
        "policy": PolicyController(models.policy, models.space.surrogate, models.calibration, course, planning.watch),
        "open_loop": ModelController(models.space, models.task, course),
        "feedforward": planned(replace(planning, feedback=0.0)),
        "planned": planned(planning),
    }
