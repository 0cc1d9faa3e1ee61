"""The hidden body obeys mechanics, its integrator converges, and a law without amplitude does nothing."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.pcc.simulator import PccSimulator
from softrl.proof.generator import laws
from softrl.proof.generator.catalogue import OUTSIDE, RIGHT, draw
from softrl.proof.generator.plant import simulate, trace
from softrl.proof.generator.program import Range, _block
from softrl.proof.generator.sensing import reported
from softrl.proof.trial import Nuisance, _body
from softrl.robots.robot import Robot
from tests.proof.conftest import body_of, loaded

HELD = np.array([20e3, 5e3, -8e3])


def stepped(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    time = 0.02 * np.arange(round(seconds / 0.02) + 1)
    command = np.where(time[:, None] > 0.1, HELD, 0.0) + 4e3 * np.sin(6.0 * time)[:, None] * [0.0, 1.0, 0.0]
    return time, command


def test_links_bend_to_the_arc_of_constant_curvature(tripod: Robot) -> None:
    """Without weight the tip comes to the closed form of an arc, with an error that falls as the square of a link."""
    time, command = np.array([0.0, 6.0]), np.tile(HELD, (2, 1))
    moment = -tripod.chamber_area_m2 * tripod.chamber_radius_m * HELD @ tripod.chamber_direction
    bend, stretch = moment / 2.9, tripod.chamber_area_m2 * tripod.length_m * HELD.sum() / 185.0
    angle, length = np.hypot(*bend), tripod.length_m * (1.0 + stretch)
    arc = length / angle * np.array([*(1.0 - np.cos(angle)) * bend / angle, np.sin(angle)])
    apart = []
    for links in (4, 8, 16):
        made = simulate(body_of(tripod, links=links, gravity=np.zeros(3)), laws.neutral_table(), time, command, 2e-3)
        apart.append(np.linalg.norm(made.position[-1] - arc))
    orders = np.log2(np.array(apart[:-1]) / apart[1:])
    assert apart[1] < 2e-4 and np.allclose(orders, 2.0, atol=0.2), (apart, orders)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (4.0, 0.0, -8.0)])
def test_a_chain_of_many_links_moves_as_the_lumped_body_does(tripod: Robot, gravity: tuple[float, float, float]) -> None:
    """Two bodies that share no code, at equal numbers: a chain is a rod in the limit, and the lumped body has its first swing."""
    robot = dataclasses.replace(tripod, gravity_m_s2=gravity)
    body = PccSimulator(robot, **{k: v for k, v in loaded("simulator/pcc.yaml").items() if k != "_target_"})
    time = 0.01 * np.arange(401)
    command = np.repeat(np.random.default_rng(0).uniform(-1e4, 3e4, (8, 3)), 51, axis=0)[:401]
    bending, _, axial = body.stiffness
    rod = body_of(robot, links=16, bending_j=bending, axial_j=axial, damping_s=body.damping_s, gravity=np.array(gravity))
    chain = simulate(rod, laws.neutral_table(), time, command, 1e-3)
    lumped = body.simulate(time[1:], command[1:])
    apart = np.linalg.norm(lumped.position - chain.position[1:], axis=1)
    moved = np.linalg.norm(chain.position - chain.position.mean(axis=0), axis=1)
    assert np.sqrt(np.mean(apart**2)) < 0.004 * np.sqrt(np.mean(moved**2)), (1e3 * apart).round(2).tolist()
    axis = Rotation.from_quat(lumped.quaternion, scalar_first=True).as_matrix()[:, :, 2]
    lean = np.arccos(np.clip(np.sum(axis * chain.rotation[1:, :, 2], axis=1), -1.0, 1.0))
    assert np.rad2deg(np.sqrt(np.mean(lean**2))) < 0.1, np.rad2deg(lean).round(2).tolist()


@pytest.mark.parametrize("elongation", [0.0, 0.1])
def test_a_body_of_one_chamber_stretches_as_the_lumped_one_does(tripod: Robot, elongation: float) -> None:
    """Else a stretch, or its lack, would be missing physics in every case."""
    robot = dataclasses.replace(tripod, chamber_angle_deg=(0.0,))
    told = {k: v for k, v in loaded("simulator/pcc.yaml").items() if k != "_target_"}
    nominal = PccSimulator(robot, **told | {"elongation_at_full_pressure": elongation})
    time = 0.01 * np.arange(301)
    command = np.repeat(np.random.default_rng(0).uniform(0.0, 3e4, (6, 1)), 51, axis=0)[:301]
    chain = simulate(_body(robot, nominal, Nuisance(), 16), laws.neutral_table(), time, command, 1e-3)
    apart = np.linalg.norm(nominal.simulate(time[1:], command[1:]).position - chain.position[1:], axis=1)
    moved = np.linalg.norm(chain.position - chain.position.mean(axis=0), axis=1)
    assert np.sqrt(np.mean(apart**2)) < 0.01 * np.sqrt(np.mean(moved**2)), (1e3 * apart).round(2).tolist()


@pytest.mark.parametrize("chambers", [1, 2, 3])
def test_ramps_are_four_triangles_of_their_chamber(chambers: int) -> None:
    """What another chamber holds meanwhile does not take their place where there is no other."""
    for chamber in range(chambers):
        made = _block(Range(-20e3, 35e3, 1e6, chambers), "ramps", chamber, 400, 1.0, np.random.default_rng(0))
        slope = np.sign(np.diff(made[:, chamber]))
        assert np.count_nonzero(np.diff(slope[slope != 0.0])) == 7 and made[:, chamber].max() > 0.75 * 35e3


def test_the_integrator_converges(tripod: Robot) -> None:
    time, command = stepped(1.5)
    tips = [
        simulate(body_of(tripod), laws.neutral_table(), time, command, h).position for h in (4e-3, 2e-3, 1e-3, 1.25e-4)
    ]
    apart = [np.sqrt(np.mean((tip - tips[-1]) ** 2)) for tip in tips[:-1]]
    assert apart[1] < 1e-4 and apart[0] > 1.6 * apart[1] > 1.6**2 * apart[2], apart


def test_energy_is_kept_without_damping_and_lost_with_it(tripod: Robot) -> None:
    """Released from a bent shape: what the integrator loses falls with its step; a damper loses all that it should."""
    time, still = 0.02 * np.arange(7), np.zeros((7, 3))
    lost = []
    for damping, step in ((0.0, 1e-4), (0.0, 1e-5), (0.05, 1e-3)):
        q, v = np.tile([0.08, -0.03, 0.0], 6), np.zeros(18)
        q[-3:] = 0.0  # beyond the last joint there is no mass: its spring would let go at once
        body = body_of(tripod, damping_s=damping, gravity=np.zeros(3))
        energy = trace(body, laws.neutral_table(), time, still, step, q, v)[1]
        lost.append(1.0 - energy[-1] / energy[0])
    assert abs(lost[1]) < 0.3 * lost[0] and abs(lost[1]) < 0.02, lost
    assert lost[2] > 0.5, lost


@pytest.mark.parametrize("name", sorted(RIGHT) + sorted(OUTSIDE))
def test_a_law_is_nothing_at_zero_and_something_at_its_largest(name: str, tripod: Robot) -> None:
    time, command = stepped(2.0)
    law = draw(name, "everywhere", 2.0, 3, np.random.default_rng(2))
    tips = []
    for amplitude in (None, 0.0, law.largest):
        table = laws.neutral_table()
        if amplitude is not None:
            law.into(table, amplitude)
        stuck = np.array([[0.05, 0.5, 0.0]])
        motion = simulate(body_of(tripod), table, time, command, 4e-3, sticking=stuck)
        tips.append(reported(table, time, motion, tripod.length_m)[0])
    assert np.array_equal(tips[0], tips[1])
    assert np.isfinite(tips[2]).all() and np.abs(tips[2] - tips[0]).max() > 2e-4


def test_slip_does_not_know_the_rate_and_damage_only_the_past() -> None:
    """A loop of slips encloses the same work at any rate; damage acts below the largest strain only."""
    table = laws.neutral_table()
    table[laws.SLIP, :2] = 0.1, 0.02
    work = []
    for steps in (400, 4000):
        state = np.zeros(laws.WALL_SLOTS)
        strain = 0.1 * np.sin(np.linspace(0.0, 4.0 * np.pi, steps + 1))
        h, total = 2.0 / steps, 0.0
        for k in range(steps):
            change = strain[k + 1] - strain[k]
            added = laws.resist(table, 0, k * h, h, strain[k + 1], change / h, 0.5, 4.0, state)
            total += added * change if k >= steps // 2 else 0.0
        work.append(total)
    assert work[0] == pytest.approx(work[1], rel=0.02) and work[0] > 0.0
    table = laws.neutral_table()
    table[laws.DAMAGE, :3] = 0.4, 0.03, 1e9
    state = np.zeros(laws.WALL_SLOTS)
    virgin, back = (laws.resist(table, 0, 0.0, 1e-3, e, 0.0, 0.0, 4.0, state) for e in (0.1, 0.05))
    assert virgin == 0.0 and back < 0.0


def test_a_joint_pulls_back_to_where_it_came_from_and_does_not_know_the_rate() -> None:
    """Straight on its pull levels off; aside it turns after the motion; back it is straight; slower is the same."""
    table = laws.neutral_table()
    table[laws.JOINT, :2] = 0.2, 0.1
    ways = []
    for steps in (500, 5000):
        drawn, h = np.zeros(2), 1.0 / steps
        for _ in range(steps):
            laws.rub(table, h, 5, np.array([0.03, 0.0]), drawn)
        straight = drawn.copy()
        for _ in range(steps):
            laws.rub(table, 2.0 * h, 5, np.array([0.0, 0.03]), drawn)
        aside = drawn.copy()
        for _ in range(steps):
            laws.rub(table, h, 5, np.array([0.0, -0.01]), drawn)
        ways.append([straight, aside, drawn.copy()])
    assert np.allclose(ways[0], ways[1], atol=3e-3)
    assert straight == pytest.approx([np.tanh(1.5), 0.0], abs=1e-3)
    assert aside == pytest.approx([straight[0] / np.cosh(3.0), np.tanh(3.0)], abs=1e-3)
    assert drawn == pytest.approx(aside - [0.0, 0.5], abs=1e-3)


def test_the_line_delays_by_its_time_and_an_orifice_settles() -> None:
    table = laws.neutral_table()
    table[laws.LINE, 0] = 0.2
    state, none = np.zeros(laws.SUPPLY_SLOTS), np.zeros((0, 3))
    out = np.array([laws.supply(table, 0, 0.0, 1e-3, 1.0, state, none) for _ in range(2000)])
    assert 1e-3 * np.sum(1.0 - out) == pytest.approx(0.2, rel=0.02)  # mean delay of a step
    table = laws.neutral_table()
    table[laws.ORIFICE, :2] = 0.3, 2.0
    lack, acting = np.zeros((1, 2)), np.zeros(1)
    for _ in range(20000):
        laws.inflate(table, 0.0, 1e-3, np.array([0.8]), lack, acting)
    assert 0.8 - acting[0] == pytest.approx(0.3 * 2.0 * np.sqrt(acting[0]), rel=0.02)
