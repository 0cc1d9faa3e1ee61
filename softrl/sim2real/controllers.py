"""The controllers that a rollout compares, made from what earlier stages left."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.calibration.pressure_map import PressureMap
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
        """Whether the simulator has effects or was retuned: it takes the robot's own pressures, f_RS was for the nominal one."""
        return self.plant.chain.corrected

    @cached_property
    def surface(self) -> Surface | None:
        """The task's surface, as stiff as the surrogate takes it to be."""
        plane = self.task.plane(self.space)
        if plane is None:
            return None
        (x, y, z), (a, b, c) = (tuple(map(float, values)) for values in plane)
        stiffness = self.space.surrogate.contact_stiffness_n_per_m
        return Surface((x, y, z), (a, b, c), float(stiffness), self.task.friction)

    @cached_property
    def yielding_n_per_m(self) -> float:
        """Stiffness across the surface of tip and surface in series: force for how far a free tip would be behind it."""
        assert self.surface is not None
        softness = self.space.twin.softness(self.space.rest[None], np.array(self.surface.normal))[0]
        return float(1.0 / (softness + 1.0 / self.surface.stiffness_n_per_m))

    def depth(self, position: np.ndarray) -> np.ndarray:
        """Return how far (steps,) m tips (steps, 3) m are behind the surface; negative before it."""
        assert self.surface is not None
        return np.asarray((np.array(self.surface.point) - position) @ np.array(self.surface.normal))

    @property
    def touching(self) -> Plant:
        """The plant with the surface."""
        chain = self.plant.chain
        if self.surface is None:
            return self.plant
        return Plant(self.plant.simulator, EffectChain(chain.robot, (*chain.effects, self.surface)))


def prepare(models: Models, planning: Planning, pace: Pace, course: Course) -> Plan:
    """Return the plan for a course: the simulator, with its effects and the task's surface, inverted."""
    start, route = ModelController(models.space, models.task, course).pressures, route_of(models, planning, pace, course)
    even = None if models.surface is None else free_route(models, planning, pace, course)
    prepared = plan(route, course.wanted, start, pace.approach_steps, planning, even)
    left = (prepared.predicted - prepared.target)[pace.approach_steps :]
    log.info("plan: %.3f mm rms from the targets in the simulation", 1e3 * np.sqrt(np.mean(np.sum(left**2, axis=1))))
    return prepared


def route_of(models: Models, planning: Planning, pace: Pace, course: Course) -> Route:
    """Return the way from requests to a course's readings, in the simulator with its effects and the task's surface.

    A tip that does not touch is told what force it lacks for it, below zero, so that a reading says how far it is.
    """

    def reading(position: np.ndarray) -> np.ndarray:
        if models.surface is None:
            return course.readings(position, np.zeros(len(position)))
        lacking = models.yielding_n_per_m * np.minimum(models.depth(position), 0.0)
        return course.readings(position, models.surface.normal_force(position) + lacking)

    return Route(models.robot, models.touching, pace.period_s, planning.dt_s, pace.average_window, reading)


def free_route(models: Models, planning: Planning, pace: Pace, course: Course) -> Route:
    """Return the same for a tip that goes through the surface, which would press it back by so much.

    Its readings answer to pressures evenly: what a tip or a wall that sticks or hardly touches answers says little about how
    far a correction will move one that does not.
    """
    chain = models.plant.chain
    plant = Plant(models.plant.simulator, EffectChain(chain.robot, tuple(e for e in chain.effects if not e.sticks)))

    def reading(position: np.ndarray) -> np.ndarray:
        return course.readings(position, models.yielding_n_per_m * models.depth(position))

    return Route(models.robot, plant, pace.period_s, planning.dt_s, pace.average_window, reading)


def controllers(models: Models, planning: Planning, pace: Pace, course: Course, prepared: Plan) -> dict[str, Controller]:
    """Return fresh controllers of one course by name.

    ``policy`` and ``planned`` see the tip; ``feedforward`` and ``open_loop`` do not. ``open_loop`` is the surrogate's static
    inverse, ``feedforward`` that of the simulator in motion.
    """
    route = route_of(models, planning, pace, course)

    def planned(settings: Planning) -> Controller:
        simulated = None if models.corrected else PressureMap(models.calibration).real_to_sim
        made = PlannedController(prepared, pace.approach_steps, settings, route, course, simulated)
        return made if models.corrected else Calibrated(made, models.calibration)

    return {
        "policy": PolicyController(models.policy, models.space.surrogate, models.calibration, course, planning.watch),
        "open_loop": ModelController(models.space, models.task, course),
        "feedforward": planned(replace(planning, feedback=0.0)),
        "planned": planned(planning),
    }
