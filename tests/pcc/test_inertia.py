"""Inertia of the lumped body beside that of a backbone whose kinetic energy is integrated and differentiated by numbers."""

import numpy as np
import pytest

from softrl.pcc.inertia import AXIAL, add_inertia, inertia_of
from softrl.pcc.simulator import PccSimulator, PccState
from tests.pcc.test_pcc import kinetic, simulator

LENGTH, MASS = 0.3, 0.8
SHARES, WEIGHTS = ((x + 1.0) / 2.0 for x in np.polynomial.legendre.leggauss(30))
WEIGHTS = WEIGHTS - 0.5
ORDER = (0.0,) * 5


def points(y: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return where the backbone (shares, 3) m is: integrals of its tangent."""
    s = shares[:, None] * SHARES
    lean = y[:2] * s[..., None] + y[3:] * (s - s**2)[..., None]
    angle = np.linalg.norm(lean, axis=2, keepdims=True)
    tangent = np.concatenate([np.sinc(angle / np.pi) * lean, np.cos(angle)], axis=2)
    return np.asarray(LENGTH * (1.0 + y[2]) * shares[:, None] * np.einsum("k,ski->si", WEIGHTS, tangent))


def mass_matrix(y: np.ndarray, end: float) -> np.ndarray:
    """Return the mass matrix (5, 5) J s^2; along the axis it has the inertia of its first mode, not of an even stretch."""
    at = np.r_[SHARES, 1.0]
    step = 1e-5 * np.eye(5)
    slopes = np.stack([(points(y + h, at) - points(y - h, at)) / 2e-5 for h in step], axis=2)
    found = np.einsum("s,ski,skj->ij", np.r_[MASS * WEIGHTS, end], slopes, slopes)
    found[2, 2] += MASS * LENGTH**2 * (AXIAL - 1.0 / 3.0)
    return np.asarray(found)


def force_by_numbers(y: np.ndarray, rate: np.ndarray, gained: np.ndarray, end: float) -> np.ndarray:
    """Return Lagrange's force (5,) J: how momentum changes, less how the energy of motion changes with the shape."""
    h = 1e-3
    slopes = [(mass_matrix(y + d, end) - mass_matrix(y - d, end)) / (2.0 * h) for d in h * np.eye(5)]
    changed = np.einsum("kij,k,j->i", slopes, rate, rate)
    return np.asarray(mass_matrix(y, end) @ gained + changed - 0.5 * np.einsum("kij,i,j->k", slopes, rate, rate))


def force(y: np.ndarray, rate: np.ndarray, gained: np.ndarray, end: float) -> np.ndarray:
    out = np.zeros(5)
    add_inertia(y, rate, gained, out, inertia_of(LENGTH, MASS, end), ORDER)
    return out


def moved(amplitude: float, uneven: float) -> list[np.ndarray]:
    """Return coordinates, rates and accelerations; what is elongated is of the order of the bends' squares."""
    scale = amplitude * np.array([1.0, 1.0, amplitude, uneven, uneven])
    rng = np.random.default_rng(3)
    return [scale * v for v in (np.array([0.6, -0.8, 0.05, 1.0, 0.5]), rng.normal(0, 3.0, 5), rng.normal(0, 20.0, 5))]


@pytest.mark.parametrize("end", [0.0, 0.3])
def test_an_arcs_inertia_is_right_to_fourth_order_and_near_at_large_bends(end: float) -> None:
    apart = []
    for amplitude in (1.0, 0.5, 0.25):
        mine, its = (f(*moved(amplitude, 0.0), end)[:3] for f in (force, force_by_numbers))
        assert np.linalg.norm(mine - its) < 0.004 * np.linalg.norm(its), (amplitude, mine, its)
        apart.append(np.linalg.norm((mine - its)[:2]) / amplitude)
    assert apart[0] > 12.0 * apart[1] > 144.0 * apart[2], apart


@pytest.mark.parametrize(("uneven", "within"), [(0.3, 0.03), (1.0, 0.08)])
def test_with_an_uneven_bend_inertia_is_near(uneven: float, within: float) -> None:
    mine, its = (f(*moved(0.5, uneven), 0.2) for f in (force, force_by_numbers))
    assert np.linalg.norm(mine - its) < within * np.linalg.norm(its), (mine, its)


@pytest.mark.parametrize(("bend", "within"), [(1.0, 0.002), (2.0, 0.02)])
def test_inertia_of_large_arcs_in_their_plane_and_across_it(bend: float, within: float) -> None:
    arc = np.array([bend, 0.0, 0.0, 0.0, 0.0])
    mine = [force(arc, np.zeros(5), turned, 0.0)[k] for k, turned in enumerate(np.eye(5)[:2])]
    np.testing.assert_allclose(mine, np.diag(mass_matrix(arc, 0.0))[:2], rtol=within)


@pytest.mark.parametrize("end", [0.0, 0.3, 50.0])
def test_the_energy_of_motion_is_positive_in_any_shape(end: float) -> None:
    rng, inertia = np.random.default_rng(0), inertia_of(LENGTH, MASS, end)
    for y in rng.uniform(-1.0, 1.0, (300, 5)) * [9.0, 9.0, 0.25, 3.0, 3.0]:
        matrix = np.stack([force(y, np.zeros(5), turned, end) for turned in np.eye(5)])
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
        assert np.linalg.eigvalsh(matrix).min() > -1e-12 * inertia.reach, y


def test_forces_do_the_work_that_the_energy_of_motion_gains() -> None:
    y, rate, gained = moved(1.2, 0.8)
    h = 1e-6
    inertia = inertia_of(LENGTH, MASS, 0.2)
    later, before = (kinetic(inertia, y + d * rate, rate + d * gained) for d in (h, -h))
    np.testing.assert_allclose(force(y, rate, gained, 0.2) @ rate, (later - before) / (2.0 * h), rtol=1e-7)


def test_a_finger_moves_as_a_body_does_that_is_pushed_in_its_plane() -> None:
    """The plane of one chamber, two coordinates instead of five."""
    flat, out = [v[[0, 3]] for v in moved(1.5, 0.6)], np.zeros(2)
    add_inertia(*flat, out, inertia_of(LENGTH, MASS, 0.2), (0.0, 0.0))
    whole = [np.array([v[0], 0.0, 0.0, v[1], 0.0]) for v in flat]
    np.testing.assert_allclose(out, force(*whole, 0.2)[[0, 3]], rtol=1e-12)


def test_a_swing_that_nothing_damps_keeps_its_energy() -> None:
    """It turns and is stretched; what the method loses falls faster than its step."""
    body: PccSimulator = simulator(damping_s=1e-9)
    lost = []
    for dt in (1e-3, 2.5e-4):
        state = body.equilibrium(np.array([3e4, -1e4, 1e4]))
        state = body.step(state, np.tile([[2.5e4, 2e4, 0.0]], (round(0.1 / dt), 1)), dt)
        before = energy_of(body, state)
        state = body.step(state, np.zeros((round(0.2 / dt), 3)), dt)
        lost.append((before - energy_of(body, state)) / before)
    assert 0.0 < 6.0 * lost[1] < lost[0] < 3e-3, lost


def energy_of(body: PccSimulator, state: PccState) -> float:
    """Return the energy, J, without pressure, of an even body without a mass at its end."""
    y, robot = state.coordinates, body.robot
    centre = WEIGHTS @ points(y, SHARES) * robot.length_m / LENGTH
    elastic = 0.5 * body._model.stiffness @ y**2 + body._model.axial_weight * y[2]
    moving = kinetic(body._model.inertia, y, state.velocity)
    return float(moving + elastic - robot.mass_kg * np.array(robot.gravity_m_s2) @ centre)
