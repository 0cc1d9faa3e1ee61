"""Which loads to compute: low-discrepancy equilibria in the order of a path, and step programs for trajectories."""

from itertools import product

import numpy as np
from scipy.stats import qmc

from softrl.robots.robot import Robot
from softrl.robots.symmetry import images_of


def sobol_loads(robot: Robot, samples: int, faces_share: float, centre: np.ndarray, seed: int) -> np.ndarray:
    """Return loads (samples, chambers + 3), Pa and N, that fill the robot's pressures and tip forces.

    Pressures fill the box of the robot's limits, the force the ball of radius ``tip_force_max_n`` about ``centre``
    (3,) N. A share of the samples has one pressure moved to a limit, so that a model fitted to them need not extrapolate there.
    """
    rng = np.random.default_rng(seed)
    sobol = qmc.Sobol(robot.chambers + 3, rng=rng)
    unit = sobol.random_base2(int(np.ceil(np.log2(samples))))[:samples]
    pressure = robot.pressure_min_pa + (robot.pressure_max_pa - robot.pressure_min_pa) * unit[:, : robot.chambers]
    for row in range(round(faces_share * samples)):
        pressure[row, rng.integers(robot.chambers)] = rng.choice([robot.pressure_min_pa, robot.pressure_max_pa])
    height, turn, radius = 2.0 * unit[:, -3] - 1.0, 2.0 * np.pi * unit[:, -2], unit[:, -1] ** (1.0 / 3.0)
    flat = np.sqrt(1.0 - height**2)
    force = radius[:, None] * np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return np.hstack([pressure, centre + robot.tip_force_max_n * force])


def corner_loads(robot: Robot, most: int, centre: np.ndarray) -> np.ndarray:
    """Return loads (at most ``most``, chambers + 3) with every pressure at a limit, the force ``centre`` (3,) N beside.

    Of corners that the robot's symmetries make of each other one alone. Low-discrepancy samples leave corners out, and beyond
    the samples viscosity is anybody's guess.
    """
    ends = (robot.pressure_min_pa, robot.pressure_max_pa)
    turns = [image.coordinate[: robot.chambers, : robot.chambers] for image in images_of(robot)]
    found: dict[tuple[float, ...], None] = {}
    for corner in product(ends, repeat=robot.chambers):
        if not any(tuple(turn @ corner) in found for turn in turns):
            found[corner] = None
    return np.array([[*corner, *centre] for corner in found][:most]).reshape(-1, robot.chambers + 3)


def at_corners(robot: Robot, loads: np.ndarray) -> np.ndarray:
    """Return which ``loads`` (S, chambers + 3) have every pressure at a limit (S,): a fit without one of these guesses there."""
    ends = np.array([robot.pressure_min_pa, robot.pressure_max_pa])
    return np.asarray((loads[:, : robot.chambers, None] == ends).any(axis=2).all(axis=1))


def load_scale(robot: Robot, centre: np.ndarray | None = None) -> np.ndarray:
    """Return the scale (chambers + 3,) of a load: half the pressure range, and the largest tip force.

    Of forces about a ``centre`` (3,) N that is farther from none than they are from it, that way: it is part of every path.
    """
    half = 0.5 * (robot.pressure_max_pa - robot.pressure_min_pa)
    force = max(robot.tip_force_max_n, 1e-3, 0.0 if centre is None else float(np.linalg.norm(centre)))
    return np.r_[np.full(robot.chambers, half), np.full(3, force)]


def paths(loads: np.ndarray, scale: np.ndarray, count: int) -> list[np.ndarray]:
    """Return ``count`` lists of row numbers: neighbours together, each a nearest-neighbour path from zero load.

    Every row is in one list; the lists depend on ``loads`` alone, not on how many processes work them off.
    """
    scaled = loads / scale
    groups = [np.arange(len(loads))]
    while len(groups) < count:  # halve the largest group along its widest direction
        largest = max(range(len(groups)), key=lambda g: len(groups[g]))
        rows = groups.pop(largest)
        widest = int(np.argmax(np.ptp(scaled[rows], axis=0)))
        ordered = rows[np.argsort(scaled[rows, widest], kind="stable")]
        groups += [ordered[: len(rows) // 2], ordered[len(rows) // 2 :]]
    return [_nearest_path(rows, scaled) for rows in groups if len(rows)]


def with_waypoints(
    loads: np.ndarray, chains: list[np.ndarray], scale: np.ndarray, longest: float
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return loads and chains with the ends of all load steps on the way as further samples, after those given.

    A continuation stops there anyway, so that they cost a tangent each. A change of load longer than ``longest`` (in
    units of ``scale``) is divided evenly; every chain begins at zero load, which is no sample.
    """
    further: list[np.ndarray] = []
    longer = []
    for chain in chains:
        here, path = np.zeros(loads.shape[1]), []
        for row in chain:
            steps = max(1, int(np.ceil(np.linalg.norm((loads[row] - here) / scale) / longest)))
            for share in np.arange(1, steps) / steps:
                path.append(len(loads) + len(further))
                further.append(here + share * (loads[row] - here))
            path.append(int(row))
            here = loads[row]
        longer.append(np.array(path))
    return np.vstack([loads, *further]), longer


def _nearest_path(rows: np.ndarray, scaled: np.ndarray) -> np.ndarray:
    remaining, here, path = list(rows), np.zeros(scaled.shape[1]), []
    while remaining:
        nearest = int(np.argmin(((scaled[remaining] - here) ** 2).sum(axis=1)))
        path.append(remaining.pop(nearest))
        here = scaled[path[-1]]
    return np.array(path)


def step_program(robot: Robot, time: np.ndarray, hold_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return loads (steps, chambers + 3), Pa and N: random pressures and tip forces, each held ``hold_s``.

    Pressures move to the next level at the robot's slew rate; the force jumps, and is zero in every second hold.
    """
    dt = float(time[1] - time[0])
    index = np.minimum((time - time[0] + 1e-9) // hold_s, len(time)).astype(int)
    holds = int(index.max()) + 1
    level = rng.uniform(robot.pressure_min_pa, robot.pressure_max_pa, (holds, robot.chambers))
    direction = rng.standard_normal((holds, 3))
    force = robot.tip_force_max_n * rng.random((holds, 1)) * direction / np.linalg.norm(direction, axis=1)[:, None]
    force[::2] = 0.0
    load = np.zeros((len(time), robot.chambers + 3))
    pressure = np.zeros(robot.chambers)
    for step, hold in enumerate(index):
        reach = robot.slew_pa_per_s * dt
        pressure = pressure + np.clip(level[hold] - pressure, -reach, reach)
        load[step] = np.r_[pressure, force[hold]]
    return load
