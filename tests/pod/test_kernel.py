"""The compiled equations: derivatives, passivity, convergence in time, extrapolation."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.rom import NO_HOOKS, roll, static_coordinates
from softrl.pod.step.chord import fill_chord
from softrl.pod.step.inertia import add_inertia, fill_amplitudes, fill_inertia, make_course
from softrl.pod.step.inside import make_inside
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.linear import solve_general
from softrl.pod.step.potential import fill_potential, make_room
from softrl.pod.step.tables import tables_of
from softrl.pod.step.viscosity import fill_viscosity
from softrl.robots.robot import Robot
from tests.pod.mechanics import mechanical_energy

Body = tuple[Robot, Snapshots, ReducedModel]


def potential(model: ReducedModel) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return y -> (gradient, Hessian) of the potential."""
    tables, r = tables_of(model), model.order
    room = make_room(tables)

    def derivatives(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gradient, hessian = np.empty(r), np.empty((r, r))
        fill_potential(y, tables, room, gradient, hessian)
        return gradient, hessian

    return derivatives


@pytest.mark.parametrize("radius", [0.4, 1.3, 4.0])
def test_the_hessian_is_the_gradients_derivative(body: Body, radius: float) -> None:
    derivatives, r = potential(body[2]), body[2].order
    y = np.random.default_rng(1).standard_normal(r)
    y *= radius / np.linalg.norm(y)
    step = 1e-6
    numeric = np.array([(derivatives(y + e)[0] - derivatives(y - e)[0]) / (2 * step) for e in step * np.eye(r)])
    hessian = derivatives(y)[1]
    error = np.abs(numeric - hessian).max() / np.abs(hessian).max()
    assert error < 1e-7, f"relative error {error:g} at radius {radius:g}"
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-12 * np.abs(hessian).max())


def test_the_gradient_is_the_energys_derivative(body: Body) -> None:
    model = body[2]
    z = model.frame @ np.full(model.order, 0.2)
    step = 1e-4 * np.diag(model.frame)
    still = np.zeros((1, model.order))
    numeric = [
        (mechanical_energy(model, (z + e)[None], still) - mechanical_energy(model, (z - e)[None], still))[0]
        for e in np.diag(step)
    ] / (2 * step)
    gradient = np.linalg.inv(model.frame).T @ potential(model)(np.full(model.order, 0.2))[0]
    np.testing.assert_allclose(gradient * step, numeric * step, rtol=1e-5, atol=1e-9)


def test_the_continuation_has_no_kink_and_pushes_back(body: Body) -> None:
    derivatives, r = potential(body[2]), body[2].order
    rng = np.random.default_rng(3)
    at_rest = np.abs(derivatives(np.zeros(r))[1]).max()
    for _ in range(20):
        u = rng.standard_normal(r)
        u /= np.linalg.norm(u)
        for inside, outside in zip(derivatives((1 - 1e-9) * u), derivatives((1 + 1e-9) * u), strict=True):
            np.testing.assert_allclose(outside, inside, atol=1e-6 * at_rest)
        gradient, hessian = derivatives(30.0 * u)
        assert np.linalg.eigvalsh(hessian)[0] > 0.0
        assert gradient @ u > 0.0


@pytest.mark.parametrize("dt_s", [0.001, 0.01, 0.02])
def test_an_unforced_body_never_gains_energy(body: Body, dt_s: float) -> None:
    robot, snapshots, model = body
    n = model.chambers
    load = np.zeros((1, n + 3))
    load[0, :n] = 0.7 * robot.pressure_max_pa * np.linspace(1.0, -0.5, n)
    tables = tables_of(model)
    y = tables.inverse @ static_coordinates(model, load)[0]
    velocity, energy = np.random.default_rng(0).standard_normal(model.order), []
    inner = np.random.default_rng(1).standard_normal((2, 6))
    for _ in range(200):
        state = [(model.frame @ part)[None] for part in (y, velocity)]
        energy.append(mechanical_energy(model, *state, None, inner[None], dt_s)[0])
        failed, *_ = run_kernel(
            y,
            velocity,
            inner,
            np.zeros(model.order),
            dt_s,
            np.zeros((1, model.order)),
            tables,
            NO_HOOKS,
            np.empty((0, model.order)),
            np.empty((0, 3)),
            np.empty((0, 4)),
        )
        assert failed == 0
        if np.linalg.norm(y) > 1.0:  # the polynomial is the energy only inside
            energy.clear()
    gain = np.diff(energy).max()
    assert gain <= 1e-12 * np.ptp(energy), f"energy rises by {gain:g} J"
    assert len(energy) > 150


def test_an_inside_of_any_map_gains_no_energy(tripod: Body) -> None:
    """Stiffness, masses and viscosity are squares of roots, so that no polynomial, however wild, makes them drive the body."""
    _, _, model = tripod
    rng = np.random.default_rng(2)
    rough = {name: rng.standard_normal((rows, 28)) * size for name, rows, size in (
        ("give", 9, 9e-3), ("inner_give", 21, 9e-3), ("inner_root", 57, 1e-4), ("drag_root", 57, 1e-2),
        ("stiffness_root_by_gravity", 63, 0.05),
    )}  # fmt: skip
    wild = replace(model, **rough)
    tables, y = tables_of(wild), 0.15 * rng.standard_normal(6)
    velocity, inner, energy = rng.standard_normal(6), 3.0 * rng.standard_normal((2, 6)), []
    for _ in range(200):
        state = (wild, (wild.frame @ y)[None], (wild.frame @ velocity)[None], None, inner[None], 0.01)
        energy.append(mechanical_energy(*state)[0])
        run_kernel(
            y, velocity, inner, np.zeros(6), 0.01, np.zeros((1, 6)), tables, NO_HOOKS, np.empty((0, 6)),
            np.empty((0, 3)), np.empty((0, 4)),
        )
        assert np.linalg.norm(y) < 1.0
    assert np.diff(energy).max() <= 1e-9 * np.ptp(energy)


def test_motion_converges_with_the_time_step(tripod: Body) -> None:
    robot, _, model = tripod
    end = []
    for steps in (500, 1000, 2000, 4000):
        load = np.zeros((1, steps, 6))
        load[..., 0] = 0.5 * robot.pressure_max_pa
        end.append(roll(model, 0.12 / steps, load)[0, -1, 3:])
    change = np.linalg.norm(np.diff(end, axis=0), axis=1)
    order = np.log2(change[:-1] / change[1:])
    assert (order > 0.8).all(), f"orders {order}"


def test_a_long_step_is_the_equilibrium(tripod: Body) -> None:
    robot, _, model = tripod
    load = np.zeros((1, 400, 6))
    load[..., 1] = 0.5 * robot.pressure_max_pa
    settled = roll(model, 0.02, load)[0, -1]
    np.testing.assert_allclose(settled[3:], static_coordinates(model, load[0, :1])[0, 3:], atol=1e-7)


@pytest.mark.parametrize("radius", [0.5, 1.4])
def test_a_step_has_the_force_of_its_square(tripod: Body, radius: float) -> None:
    """By the derivative by its arrival, the metric half way."""
    rng, r = np.random.default_rng(0), 6
    tables = tables_of(replace(tripod[2], stiffness_root=rng.standard_normal((21, 84))))
    metric, work = (tables.stiffness_root, tables.stiffness_factor), make_room(tables)

    def chord(start: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        matrix, slope = np.empty((r, r)), np.empty(r)
        fill_chord(metric, start + 0.5 * by, by, 1, tables, work, matrix, slope)
        return matrix, slope

    start = rng.standard_normal(r)
    start *= radius / np.linalg.norm(start)
    by, step = 0.3 * rng.standard_normal(r), 1e-6

    def half_square(by: np.ndarray) -> float:
        return 0.5 * float(by @ chord(start, by)[0] @ by)

    exact = np.array([half_square(by + e) - half_square(by - e) for e in step * np.eye(r)]) / (2.0 * step)
    matrix, slope = chord(start, by)
    np.testing.assert_allclose(matrix @ by + slope, exact, atol=1e-6 * np.abs(exact).max())
    assert np.abs(slope).max() > 0.01 * np.abs(exact).max()
    assert np.linalg.eigvalsh(matrix)[0] >= -1e-12 * np.abs(matrix).max()


def test_a_step_of_viscosity_never_drives(tripod: Body) -> None:
    """However wild the map."""
    rng, r = np.random.default_rng(0), 6
    tables = tables_of(replace(tripod[2], stiffness_root=rng.standard_normal((21, 84))))
    work = make_room(tables)
    held = np.empty((r, r)), np.empty((r, r)), np.empty(r), make_inside(r, ()), make_course(r, 6, ())
    drives = 0
    for _ in range(200):
        middle, by = 0.3 * rng.standard_normal(r), 2.0 * rng.standard_normal(r)
        start = middle - 0.5 * by
        fill_chord((tables.stiffness_root, tables.stiffness_factor), middle, by, 1, tables, work, held[1], held[2])
        drives += by @ (held[1] @ by + held[2]) < 0.0
        fill_viscosity(start, by, tables, work, held)
        assert by @ (held[1] @ by + held[2]) >= -1e-9 * (by @ held[1] @ by)
    assert drives > 0  # it would, without the limit


def test_inertia_is_that_of_the_masses_on_their_curves(tripod: Body) -> None:
    """Masses that are led by amplitudes a resist with the derivative of half |a(y) - 2 a_0 + a_-1|^2, however long the step."""
    rng, r, dt = np.random.default_rng(0), 6, 0.02
    wild = np.c_[np.zeros(9), rng.standard_normal((9, 209))]
    tables = tables_of(replace(tripod[2], amplitudes=wild))
    work, course = make_room(tables), make_course(r, 9, ())
    held = np.empty((r, r)), np.empty((r, r)), np.empty(r), make_inside(r, ()), course

    def place(y: np.ndarray) -> np.ndarray:
        found = np.empty(9)
        fill_amplitudes(y, 0, False, tables, work, found, course.lead)
        return found

    before, start, aim = 0.25 * rng.standard_normal((3, r))
    course.before[:], course.now[:] = place(before), place(start)

    def half_square(y: np.ndarray) -> float:
        return float(0.5 * ((place(y) - 2.0 * course.now + course.before) ** 2).sum()) / dt**2

    exact = np.array([half_square(aim + e) - half_square(aim - e) for e in 1e-6 * np.eye(r)]) / 2e-6
    fill_inertia(start, aim - start, tables, work, held)
    inertia, right = np.zeros((r, r)), np.zeros(r)
    add_inertia(1.0 / dt**2, 0.0, held, inertia, right)
    np.testing.assert_allclose(inertia @ aim - right, exact, atol=1e-6 * np.abs(exact).max())
    np.testing.assert_allclose(inertia * dt**2, held[0], rtol=1e-12)


def test_elimination_solves() -> None:
    matrix = np.random.default_rng(0).standard_normal((6, 6)) + 3.0 * np.eye(6)
    right, answer = np.arange(6.0) - 2.0, np.empty(6)
    assert solve_general(matrix.copy(), right, answer)
    np.testing.assert_allclose(matrix @ answer, right, atol=1e-12)
