"""What changes walls: of one chamber or all, one law after another, on bodies that stretch, hardly stretch or lack a plane."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from softrl.effects.chain import Plant, chain_of
from softrl.effects.drift import Drift
from softrl.effects.effect import Effect
from softrl.effects.mount_tilt import MountTilt
from softrl.effects.mullins import Mullins
from softrl.effects.port import ADDED, ELASTIC, PRESSURE, REST, STRAIN, body_port
from softrl.effects.stiffness_scale import StiffnessScale
from softrl.effects.strain_softening import StrainSoftening
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.pod.simulator import RomSimulator
from tests.effects.test_library import ACTING, simulator, typical
from tests.pod.conftest import fitted

WALLS = [name for name in ACTING if typical(name).site == "body" and hasattr(typical(name), "chamber")]


def segment(elongation: float, angles: tuple[float, ...] = (-120.0, 120.0, 0.0)) -> PccSimulator:
    """Return a light segment that gets longer by ``elongation`` at full pressure."""
    body = simulator("three_chamber_segment")
    robot = replace(body.robot, chamber_angle_deg=angles, gravity_m_s2=(0.0, 0.0, 0.0))
    return replace(body, robot=robot, elongation_at_full_pressure=elongation)


def rest_of(
    body: PccSimulator | RomSimulator, effects: Sequence[Effect], pressure: Sequence[float], force: Sequence[float] = (0.0,) * 3
) -> np.ndarray:
    """Return where the tip has come after 4 s, m."""
    time = 0.01 * np.arange(1, 401)
    held, pushed = (np.tile(np.asarray(row, dtype=float), (len(time), 1)) for row in (pressure, force))
    moved: np.ndarray = Plant(body, chain_of(body.robot, effects)).simulate(time, held, pushed).position[-1]
    return moved


@pytest.mark.parametrize("elongation", [0.03, 0.0])
def test_walls_of_a_body_that_hardly_stretches_are_those_that_bend(elongation: float) -> None:
    """What holds the length is none of them: one that is stiffer, or softer, changes the bend by its share."""
    body, pressure = segment(elongation), (0.0, 0.0, 1e5)
    bare = rest_of(body, [], pressure)[0]
    of_each = rest_of(body, [StiffnessScale(1.4, chamber) for chamber in range(3)], pressure)[0]
    np.testing.assert_allclose(of_each, rest_of(body, [StiffnessScale(1.4)], pressure)[0], rtol=0.002)
    np.testing.assert_allclose(of_each / bare, 1.0 / 1.4, rtol=0.02)
    for effect in (StiffnessScale(1.4, 2), Viscoelasticity(0.4, 100.0, 0.0, 1.0, 2), StrainSoftening(1.0)):
        assert 0.6 < rest_of(body, [effect], pressure)[0] / bare < 1.6, effect


def test_factors_on_the_stiffness_multiply() -> None:
    body, pressure = segment(0.1), (0.0, 0.0, 2e4)
    quarter = replace(body, bending_stiffness_scale=0.25, axial_stiffness_scale=0.25)
    wanted = rest_of(quarter, [], pressure)
    np.testing.assert_allclose(rest_of(body, [StiffnessScale(0.5), StiffnessScale(0.5)], pressure), wanted, atol=1e-6)
    several, added = [StiffnessScale(0.6), Drift(0.02), StrainSoftening(1.0), Mullins(0.3, 0.05)], []
    for order in (several, several[::-1]):
        port = body_port(3)
        port[STRAIN], port[REST], port[ELASTIC] = 0.03, 2e6, 7e4
        for effect in order:
            state = effect.reset(body.robot) + (1e-2 if isinstance(effect, Mullins) else 30.0)
            port = effect.apply(body.robot, state, port, 0.01)[1]
        added.append(port[ADDED])
    np.testing.assert_allclose(*added, rtol=1e-12)
    assert np.all(added[0] > -7e4), "what is left of the resistance is left of what was there"


@pytest.mark.parametrize("angles", [(0.0, 180.0), (0.0, 90.0)])
def test_a_stiffer_body_of_two_chambers_is_stiffer_out_of_their_plane_too(angles: tuple[float, ...]) -> None:
    body = segment(0.1, angles)
    twice = replace(body, bending_stiffness_scale=2.0, axial_stiffness_scale=2.0)
    for force in ((0.0, 0.3, 0.0), (0.3, 0.0, 0.0)):
        told = rest_of(body, [StiffnessScale(2.0)], (0.0, 0.0), force)
        np.testing.assert_allclose(told, rest_of(twice, [], (0.0, 0.0), force), atol=2e-5)


@pytest.mark.parametrize("angles", [(0.0, 180.0), (0.0, 90.0), (0.0, 120.0), (-120.0, 120.0, 0.0), (0.0, 90.0, 180.0, 270.0)])
def test_a_force_moves_the_tip_across_it_as_one_across_does_along_it(angles: tuple[float, ...]) -> None:
    """Betti's law, of walls that have not relaxed yet: whatever chambers leave open, no closed path gains work."""
    body, effect, push = segment(0.1, angles), Viscoelasticity(5.0, 300.0, 0.0, 1.0), 0.05
    forces, none = push * np.eye(3), np.zeros(len(angles))
    moved = [rest_of(body, [effect], none, force) - rest_of(body, [effect], none, -force) for force in forces]
    np.testing.assert_allclose(moved, np.transpose(moved), atol=1e-3 * np.abs(moved).max())


@pytest.mark.parametrize("name", WALLS)
def test_what_is_said_of_one_wall_depends_on_its_own_strain(name: str) -> None:
    """Else a closed path would gain work: the pressure that holds a chamber is in part that of the others' walls."""
    effect = replace(typical(name), chamber=1)
    robot = simulator("three_chamber_segment").robot
    added = []
    for elastic in (0.0, 5e4):
        port = body_port(3)
        port[STRAIN], port[REST], port[PRESSURE], port[ELASTIC] = 0.05, 2e6, 1e5, elastic
        added.append(effect.apply(robot, effect.reset(robot), port, 0.01)[1][ADDED])
    np.testing.assert_array_equal(added[0], added[1])


def light_rom(**scales: float) -> RomSimulator:
    robot, _, model = fitted(3)
    free = replace(robot, gravity_m_s2=(0.0, 0.0, 0.0))
    return RomSimulator(free, model, **({"youngs_modulus_scale": 1.0, "mass_scale": 1.0, "damping_scale": 1.0} | scales))


def test_a_stiffer_reduced_body_resists_tip_forces_too() -> None:
    body, stiffer = light_rom(), light_rom(youngs_modulus_scale=1.5)
    pressure, force = np.full(3, 0.2 * body.robot.pressure_max_pa), (0.3 * body.robot.tip_force_max_n, 0.0, 0.0)
    bare, told, wanted = (rest_of(b, e, pressure, force) for b, e in ((body, []), (body, [StiffnessScale(1.5)]), (stiffer, [])))
    assert np.linalg.norm(bare - wanted) > 1e-4
    np.testing.assert_allclose(told, wanted, atol=1e-6)


def test_a_reduced_body_stays_at_its_rest_where_it_is_tilted_and_stiffer() -> None:
    robot, _, model = fitted(3)
    body = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    for effect in (StiffnessScale(1.5), Viscoelasticity(1.0, 2.0, 0.0, 1.0)):
        chain = chain_of(robot, [MountTilt(0.3, 0.0), effect])
        moved = Plant(body, chain).simulate(0.01 * np.arange(1, 201), np.zeros((200, 3))).position
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-7)
