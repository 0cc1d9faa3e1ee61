"""Which loads are computed, and in which order."""

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.fem.continuation import Equilibrium, follow
from softrl.fem.sampling import corner_loads, load_scale, paths, sobol_loads, step_program, with_waypoints
from softrl.robots.symmetry import symmetries
from tests.fem.bodies import box_robot, model_of
from tests.pod.synthetic import robot_with

ROBOT = box_robot(3)
CENTRE = np.array([0.0, 0.1, -0.3])


def test_loads_keep_the_robots_limits_and_reach_them() -> None:
    loads = sobol_loads(ROBOT, 100, 0.25, CENTRE, seed=1)
    pressure, force = loads[:, :3], np.linalg.norm(loads[:, 3:] - CENTRE, axis=1)
    assert loads.shape == (100, 6)
    assert pressure.min() >= ROBOT.pressure_min_pa and pressure.max() <= ROBOT.pressure_max_pa
    assert ((pressure == ROBOT.pressure_min_pa) | (pressure == ROBOT.pressure_max_pa)).any(axis=1).sum() >= 25
    assert 0.9 * ROBOT.tip_force_max_n < force.max() <= ROBOT.tip_force_max_n
    assert np.abs((loads[:, 3:] - CENTRE).mean(axis=0)).max() < 0.1 * ROBOT.tip_force_max_n


@pytest.mark.parametrize(("chambers", "count"), [(1, 2), (2, 3), (3, 4), (4, 6)])
def test_corners_and_their_images_are_all_corners(chambers: int, count: int) -> None:
    robot = robot_with(chambers)
    loads = corner_loads(robot, 20, np.array([0.0, 0.0, -0.3]))
    assert len(loads) == count
    images = {tuple(image.coordinate @ load) for image in symmetries(robot.chamber_direction) for load in loads}
    assert len({image[:chambers] for image in images}) == 2**chambers
    assert len(corner_loads(robot, 1, np.zeros(3))) == 1 and corner_loads(robot, 0, np.zeros(3)).shape == (0, chambers + 3)


def test_the_same_seed_gives_the_same_loads() -> None:
    assert (sobol_loads(ROBOT, 16, 0.5, CENTRE, 3) == sobol_loads(ROBOT, 16, 0.5, CENTRE, 3)).all()
    assert (sobol_loads(ROBOT, 16, 0.5, CENTRE, 3) != sobol_loads(ROBOT, 16, 0.5, CENTRE, 4)).any()


def test_paths_hold_every_load_once_and_are_shorter_than_chance() -> None:
    loads, scale = sobol_loads(ROBOT, 64, 0.0, CENTRE, 0), load_scale(ROBOT)
    chains = paths(loads, scale, 4)
    assert sorted(np.concatenate(chains)) == list(range(64))

    def length(order: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(loads[order] / scale, axis=0), axis=1).sum())

    assert sum(length(c) for c in chains) < 0.75 * length(np.arange(64))


def test_waypoints_divide_every_way_evenly_and_keep_the_samples() -> None:
    loads, scale = sobol_loads(ROBOT, 16, 0.0, CENTRE, 0), load_scale(ROBOT)
    more, chains = with_waypoints(loads, paths(loads, scale, 3), scale, 0.8)
    assert sorted(np.concatenate(chains)) == list(range(len(more)))
    np.testing.assert_array_equal(more[:16], loads)
    for chain in chains:
        steps = np.linalg.norm(np.diff(more[chain] / scale, axis=0, prepend=0.0), axis=1)
        assert steps.max() <= 0.8 + 1e-12
        straight = np.linalg.norm(np.diff(loads[chain[chain < 16]] / scale, axis=0, prepend=0.0), axis=1)
        assert steps.sum() == pytest.approx(straight.sum())


def test_programs_keep_the_slew_rate_and_the_limits() -> None:
    time = 0.01 * np.arange(1, 101)
    load = step_program(ROBOT, time, 0.25, np.random.default_rng(0))
    change = np.diff(load[:, :3], axis=0, prepend=0.0)
    assert np.abs(change).max() <= ROBOT.slew_pa_per_s * 0.01 + 1e-9
    assert load[:, :3].min() >= ROBOT.pressure_min_pa and load[:, :3].max() <= ROBOT.pressure_max_pa
    assert np.linalg.norm(load[:, 3:], axis=1).max() <= ROBOT.tip_force_max_n
    assert len(np.unique(load[:, 0].round(9))) >= 4


def test_a_path_ends_where_a_solve_from_rest_ends(box: Mesh) -> None:
    robot, model = box_robot(2), model_of(box)
    loads = sobol_loads(robot, 4, 0.0, CENTRE, 2)
    for load, found in zip(loads, follow(model, loads, load_scale(robot), 0.5), strict=True):
        assert isinstance(found, Equilibrium)
        alone = model.static(load)
        assert np.abs(alone.pose.position - found.pose.position).max() < 1e-7
