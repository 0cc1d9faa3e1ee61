"""Laws of the full model: patch test, closed forms, equilibrium, tangents, energy and units."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import PLATE, Mesh
from softrl.core.errors import MeshError, SolverError
from softrl.fem.material import StableNeoHookean, StVenantKirchhoff, lame
from softrl.fem.newton import NewtonSettings
from softrl.fem.solver import SuperLuSolver
from softrl.fem.trajectory import roll_out
from tests.fem.bodies import NEWTON, bar, error_norms, hollow_box, hollow_sphere, model_of, solved_inside

LOAD = np.array([4e3, -2e3, 0.2, -0.1, 0.15])  # two chambers, Pa and N


def test_patch_a_uniform_strain_is_exact() -> None:
    change = np.eye(3) + 0.1 * np.random.default_rng(0).standard_normal((3, 3))
    found, exact, _ = solved_inside(2, lambda x: x @ change.T, StableNeoHookean(1e6, 0.45))
    assert np.abs(found - exact).max() < 1e-12


def test_patch_a_pure_bending_is_exact_for_quadratic_elements() -> None:
    # small bending about y: u = k (x z, -nu y z, (nu (y^2 - z^2) ... ) solves Navier's equations and is quadratic
    nu, k = 0.4, 1e-7

    def exact(x: np.ndarray) -> np.ndarray:
        a, b, c = x.T
        return x + k * np.stack([a * c, -nu * b * c, -0.5 * a * a + 0.5 * nu * (b * b - c * c)], axis=1)

    found, wanted, _ = solved_inside(2, exact, StVenantKirchhoff(1e6, nu))
    bent = k * 0.02**2
    assert np.abs(found - wanted).max() < 1e-5 * bent


@pytest.mark.parametrize(("element_order", "mean", "cells", "least"), [
    (1, False, (4, 8), (1.6, 0.75)), (2, False, (2, 4), (2.6, 1.75)),
    # one volume condition an element costs an order, and buys that nothing locks
    pytest.param(2, True, (4, 8), (1.8, 0.9), marks=pytest.mark.slow),
    pytest.param(2, False, (4, 8), (2.8, 1.85), marks=pytest.mark.slow),
])
def test_manufactured_solution_converges_with_the_order_of_the_element(
    element_order: int, mean: bool, cells: tuple[int, int], least: tuple[float, float]
) -> None:
    # u = grad(exp(q x) cos(q y)) solves Navier's equations for any moduli
    amplitude, q = 1e-9, 60.0

    def exact(x: np.ndarray) -> np.ndarray:
        grown = amplitude * np.exp(q * x[..., 0])
        return x + np.stack([grown * np.cos(q * x[..., 1]), -grown * np.sin(q * x[..., 1]), 0 * grown], axis=-1)

    def gradient(x: np.ndarray) -> np.ndarray:
        slope = np.zeros((*x.shape, 3))
        grown = amplitude * q * np.exp(q * x[..., 0])
        slope[..., 0, 0] = grown * np.cos(q * x[..., 1])
        slope[..., 1, 1] = -slope[..., 0, 0]
        slope[..., 0, 1] = slope[..., 1, 0] = -grown * np.sin(q * x[..., 1])
        return slope + np.eye(3)

    errors = []
    for count in cells:
        found, _, solid = solved_inside(
            count, exact, StableNeoHookean(1e6, 0.45), element_order=element_order, mean=mean
        )
        apart, tilt = error_norms(found, exact, gradient, solid)
        errors.append((apart, tilt))
    orders = -np.diff(np.log(errors), axis=0)[-1] / np.log(cells[-1] / cells[-2])
    assert orders[0] > least[0], f"measured order {orders[0]:.2f} of the displacement"
    assert orders[1] > least[1], f"measured order {orders[1]:.2f} of the strain"


@pytest.mark.parametrize(("mean", "within"), [(False, 0.02), (True, 0.06)])
def test_cantilever_bends_as_timoshenko_says(mean: bool, within: float) -> None:
    # the mean of an element does not see pressure vary across it, so two elements across bend too easily
    width, length, young, force = 0.01, 0.10, 1e6, 1e-3
    model = model_of(bar((2, 2, 10), (width, width, length)), StableNeoHookean(young, 0.3), mean_dilatation=mean)
    solve = model.static(np.array([0.0, force, 0.0, 0.0]))
    inertia, shear = width**4 / 12, young / 2.6
    # the rigid end face keeps plane sections plane, which is what the beam assumes
    expected = force * length**3 / (3 * young * inertia) + force * length / (5 / 6 * shear * width**2)
    assert solve.converged
    assert model.coordinate(solve.pose)[1] == pytest.approx(expected, rel=within)


@pytest.mark.slow
def test_a_pressurised_box_converges_under_refinement_from_coarse_quadratic_elements() -> None:
    # the same geometry in 1, 2 and 3 cells a wall: even the coarsest must not lock
    bends = []
    for fine in (1, 2, 3):
        mesh = hollow_box(cells=3 * fine, walls=fine, chambers=1)
        model = model_of(mesh, newton=replace(NEWTON, tolerance_m=1e-8))
        solve = model.static(np.array([2e4, 0.3, 0.0, 0.0]))
        assert solve.converged
        bends.append(model.coordinate(solve.pose)[1:])
    errors = [np.abs(b - bends[-1]).max() / np.abs(bends[-1]).max() for b in bends[:2]]
    assert errors[0] < 0.06 and errors[1] < 0.5 * errors[0], f"measured {errors}"


def test_pressure_in_a_thick_sphere_widens_it_as_lame_says() -> None:
    inner, outer, young, nu, pressure = 0.01, 0.02, 1e6, 0.4, 10.0
    mesh = hollow_sphere(inner, outer)
    model = model_of(mesh, StableNeoHookean(young, nu))
    solve = model.static(np.r_[pressure, np.zeros(3)])
    share = pressure * inner**3 / (young * (outer**3 - inner**3))
    widening = share * ((1 - 2 * nu) * inner + (1 + nu) * outer**3 / (2 * inner**2))
    expected = 3 * widening / inner  # relative change of volume, which hardly sees the facets
    assert model.coordinate(solve.pose)[0] / model.rest_volume[0] == pytest.approx(expected, rel=0.04)


def inflated(pressure_pa: float, young: float, nu: float, inner: float, outer: float) -> float:
    """Return the inner hoop stretch of a thick stable Neo-Hookean sphere under a pressure, from its radial equation.

    With r(R): d/dR P_rr + 2/R (P_rr - P_tt) = 0, P_rr = 0 outside and -p (r/R)^2 inside.
    """
    lam, mu = lame(young, nu)

    def stress(hoop: np.ndarray, radial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        push = (lam + mu) * (hoop**2 * radial - 1.0) - mu
        return mu * radial + push * hoop**2, mu * hoop + push * hoop * radial

    def radial_of(pull: np.ndarray, hoop: np.ndarray) -> np.ndarray:
        return (pull + (lam + 2.0 * mu) * hoop**2) / (mu + (lam + mu) * hoop**4)  # P_rr is linear in dr/dR

    def slope(radius: np.ndarray, y: np.ndarray) -> np.ndarray:
        hoop = y[0] / radius
        radial = radial_of(y[1], hoop)
        return np.stack([radial, 2.0 / radius * (stress(hoop, radial)[1] - y[1])])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([(a[1] + pressure_pa * (a[0] / inner) ** 2) / young, b[1] / young])

    radius = np.linspace(inner, outer, 40)
    start = np.cbrt(radius**3 + 0.3 * inner**3)
    found = solve_bvp(slope, ends, radius, np.stack([start, np.zeros_like(radius)]), tol=1e-8)
    assert found.success, found.message
    return float(found.y[0, 0] / inner)


def test_the_radial_equation_tends_to_the_closed_form_of_an_incompressible_sphere() -> None:
    young, hoop, ratio = 1e6, 1.3, 8.0
    outside = np.cbrt(1.0 + (hoop**3 - 1.0) / ratio)
    pressure = young / 3.0 * ((2.0 / outside + 0.5 / outside**4) - (2.0 / hoop + 0.5 / hoop**4))
    missed = [inflated(pressure, young, nu, 0.01, 0.02) - hoop for nu in (0.49, 0.499, 0.4999)]
    assert abs(missed[2]) < 1e-3 < abs(missed[0]), f"measured {missed}"
    assert missed[0] / missed[1] == pytest.approx(10.0, rel=0.2), f"measured {missed}"


def test_pressure_blows_a_thick_sphere_up_as_its_radial_equation_says() -> None:
    # to twice its cavity: large strains, and a pressure that follows the wall; flat facets miss by their width squared
    inner, outer, nu, pressure, facets = 0.01, 0.02, 0.45, 1.9e5, np.array([3, 4])
    grown = []
    for count in facets:
        mesh = hollow_sphere(inner, outer, layers=2, cells=int(count))
        model = model_of(mesh, StableNeoHookean(1e6, nu), newton=replace(NEWTON, tolerance_m=1e-7))
        half = model.static(np.r_[0.5 * pressure, np.zeros(3)])
        solve = model.static(np.r_[pressure, np.zeros(3)], half.pose)
        assert half.converged and solve.converged
        grown.append(np.cbrt(1.0 + model.coordinate(solve.pose)[0] / model.rest_volume[0]) - 1.0)
    limit = np.linalg.solve(np.stack([np.ones(2), facets**-2.0], axis=1), grown)[0]
    expected = inflated(pressure, 1e6, nu, inner, outer) - 1.0
    assert expected > 0.25
    assert limit == pytest.approx(expected, rel=0.01), f"the radius grows by {grown}, in the limit by {limit:.4f}"


def test_equilibrium_balances_the_base(box: Mesh) -> None:
    # a closed cavity pushes with no net force, so the base carries the tip force and the weight
    model = model_of(box, gravity_m_s2=(0.0, -3.0, -9.81))
    pose = model.static(LOAD).pose
    elastic = model._elastic(pose, 1).gradient
    base = model.coupling.body == -2
    carried = model.nodal_mass[~base].sum() * model.gravity_m_s2 + LOAD[2:]
    assert np.abs(elastic[base].sum(axis=0) + carried).max() < 1e-6 * np.abs(carried).max()


def test_compliance_is_symmetric_and_the_derivative_of_the_coordinate(box: Mesh) -> None:
    model = model_of(box)
    pose = model.static(LOAD).pose
    compliance = model.tangent(pose, LOAD).compliance
    scale = np.sqrt(np.outer(np.diag(compliance), np.diag(compliance)))
    assert (np.abs(compliance - compliance.T) / scale).max() < 1e-9
    for k, step in enumerate([10.0, 10.0, 1e-3, 1e-3, 1e-3]):
        change = step * np.eye(5)[k]
        above, below = (model.coordinate(model.static(LOAD + s * change, pose).pose) for s in (1, -1))
        numeric = (above - below) / (2 * step)
        assert (np.abs(numeric - compliance[:, k]) / scale[:, k]).max() < 1e-4


def test_load_does_the_work_that_the_body_stores(box: Mesh) -> None:
    # dW = load . dz along a path of equilibria: Simpson's rule over two load steps
    model = model_of(box)
    shares = (0.5, 0.75, 1.0)
    poses = [model.static(s * LOAD).pose for s in shares]
    rates = [s * LOAD @ model.tangent(p, s * LOAD).compliance @ LOAD for p, s in zip(poses, shares, strict=True)]
    work = 0.5 * (rates[0] + 4 * rates[1] + rates[2]) / 6
    assert model.elastic_energy(poses[2]) - model.elastic_energy(poses[0]) == pytest.approx(work, rel=1e-4)


def test_scaling_modulus_and_load_alike_changes_no_shape(box: Mesh) -> None:
    one = model_of(box).static(LOAD).pose
    ten = model_of(box, StableNeoHookean(1e7, 0.45)).static(10 * LOAD).pose
    scaled = model_of(box, stiffness_scale=10.0).static(10 * LOAD).pose
    assert np.abs(one.position - ten.position).max() < 1e-9
    assert np.abs(scaled.position - ten.position).max() < 1e-12


def test_scaling_lengths_by_ten_scales_forces_by_a_hundred(box: Mesh) -> None:
    small = model_of(box).static(LOAD).pose.position
    force = LOAD * np.r_[1, 1, 100, 100, 100]
    large = model_of(replace(box, points=10 * box.points)).static(force).pose.position
    assert np.abs(large / 10 - small).max() < 1e-9


def test_free_vibration_loses_energy_and_keeps_none(box: Mesh) -> None:
    model = model_of(box, rayleigh_stiffness_s=2e-4)
    state = model.state(model.static(LOAD).pose)
    energies = [model.elastic_energy(state.pose)]
    for _ in range(60):
        state, solve = model.step(state, np.zeros(5), 1e-3)
        assert solve.converged
        kinetic = 0.5 * float((model.nodal_mass[:, None] * state.velocity**2).sum())
        energies.append(model.elastic_energy(state.pose) + kinetic)
    assert (np.diff(energies) < 1e-9 * energies[0]).all()
    assert energies[-1] < 1e-2 * energies[0]


def test_vibration_without_damping_has_the_frequency_of_stiffness_and_mass(box: Mesh) -> None:
    # pull the tip slightly aside and let go: the period of the lowest mode, by Rayleigh's quotient of the static shape
    model = model_of(box)
    pull = np.array([0.0, 0.0, 0.0, 1e-3, 0.0])
    tangent = model.tangent(model.rest(), np.zeros(5))
    frequency = np.sqrt(tangent.stiffness[3, 3] / tangent.mass[3, 3])
    dt = 2 * np.pi / frequency / 400
    state = model.state(model.static(pull).pose)
    history = []
    for _ in range(330):
        state, _ = model.step(state, np.zeros(5), dt)
        history.append(model.coordinate(state.pose)[3])
    crossing = np.flatnonzero(np.diff(np.sign(history)))[:2]
    period = 2 * dt * (crossing[1] - crossing[0])
    assert period == pytest.approx(2 * np.pi / frequency, rel=0.03)


def test_implicit_euler_is_of_first_order(box: Mesh) -> None:
    model = model_of(box, rayleigh_stiffness_s=2e-3)
    ends = []
    for dt in (8e-4, 4e-4, 2e-4):
        state = model.state()
        for _ in range(round(8e-3 / dt)):
            state, _ = model.step(state, LOAD, dt)
        ends.append(model.coordinate(state.pose))
    ratio = np.linalg.norm((ends[0] - ends[1])[2:]) / np.linalg.norm((ends[1] - ends[2])[2:])
    assert 1.6 < ratio < 2.6, f"measured ratio {ratio:.2f}"


def test_implicit_euler_loses_energy_in_proportion_to_its_step() -> None:
    # no damping: all that a freely swinging bar loses is the integrator's, and goes to zero with order 1
    mesh = bar((1, 1, 4), (0.01, 0.01, 0.04))
    pulled = model_of(mesh).static(np.array([0.0, 0.02, 0.0, 0.0])).pose
    lost = []
    for dt in (4e-4, 2e-4, 1e-4):
        model = model_of(mesh)
        state = model.state(pulled)
        start = model.elastic_energy(pulled)
        for _ in range(round(0.008 / dt)):
            state, solve = model.step(state, np.zeros(4), dt)
            assert solve.converged
        kinetic = 0.5 * float((model.nodal_mass[:, None] * state.velocity**2).sum())
        lost.append(1.0 - (model.elastic_energy(state.pose) + kinetic) / start)
    order = np.log2(np.array(lost[:-1]) / lost[1:])
    assert 0.0 < lost[-1] < lost[-2] < lost[-3]
    assert np.abs(order - 1.0).max() < 0.25, f"measured order {order}, lost {lost}"


def test_both_linear_solvers_agree(box: Mesh) -> None:
    best = model_of(box).static(LOAD).pose
    plain = model_of(box, solver=SuperLuSolver()).static(LOAD).pose
    assert np.abs(best.position - plain.position).max() < 1e-12


def test_reused_factors_give_the_same_equilibrium(box: Mesh) -> None:
    always = model_of(box, newton=replace(NEWTON, reuse_below=0.0)).static(LOAD)
    often = model_of(box).static(LOAD)
    assert often.factorisations < always.factorisations
    assert np.abs(always.pose.position - often.pose.position).max() < 1e-9


def test_without_reuse_every_iteration_of_every_step_has_its_own_factors(box: Mesh) -> None:
    model = model_of(box, newton=replace(NEWTON, reuse_below=0.0))
    state = model.state()
    for _ in range(2):
        state, solve = model.step(state, LOAD, 1e-3)
        assert solve.factorisations == solve.iterations > 0


def test_a_solve_ends_where_its_factorisations_are_used_up(box: Mesh) -> None:
    fresh = replace(NEWTON, reuse_below=0.0)
    whole = model_of(box, newton=fresh).static(LOAD)
    ended = model_of(box, newton=fresh).static(LOAD, most_factors=whole.factorisations - 1)
    assert whole.converged and not ended.converged
    assert ended.factorisations == whole.factorisations - 1 > 0
    enough = model_of(box, newton=fresh).static(LOAD, most_factors=whole.factorisations)
    np.testing.assert_array_equal(enough.pose.position, whole.pose.position)


@pytest.mark.parametrize("share", [0.9, 1.05])
def test_a_short_step_by_a_shifted_stiffness_is_no_equilibrium(share: float) -> None:
    # a column pressed by more than Euler's load, and a little aside: it is on its way, and the shift makes its steps short
    width, height, young = 4e-3, 0.06, 1e6
    euler = np.pi**2 * young * width**4 / 12.0 / (4.0 * height**2)
    model = model_of(bar((2, 2, 10), (width, width, height)), newton=NewtonSettings(1e-6, 40, 0.5))
    load = np.array([0.0, 1e-6, 0.0, -share * euler])
    at_rest, solve = model.static(load), model.step(model.state(), load, 1e9).solve
    assert at_rest.converged and solve.converged
    if share < 1.0:
        assert at_rest.failure == solve.failure == ""
    else:
        assert "not stable" in at_rest.failure and "not stable" in solve.failure
        assert "not stable" in model.step(model.state(), load, 1e9).solve.failure  # not by the factors that the first one left
        with pytest.raises(SolverError, match=r"step 1 of 1e\+09 s failed, the equilibrium is not stable.*smaller stage.dt_s"):
            roll_out(model, load[None], 1e9, model.rest())


def test_newton_converges_quadratically(box: Mesh) -> None:
    steps = np.array(model_of(box, newton=NewtonSettings(1e-10, 60, 0.0)).static(LOAD).steps_m)
    assert steps[-1] < 50.0 * steps[-2] ** 1.6


def test_turning_load_and_body_together_turns_the_answer() -> None:
    mesh = hollow_box(chambers=1)
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    force = np.array([0.1, 0.05, -0.2])
    straight = model_of(mesh).static(np.r_[2e3, force]).pose.position
    turned = model_of(replace(mesh, points=mesh.points @ turn.T)).static(np.r_[2e3, turn @ force]).pose.position
    assert np.abs(turned - straight @ turn.T).max() < 1e-9


def test_a_mesh_without_plate_is_refused(box: Mesh) -> None:
    with pytest.raises(MeshError, match="no plate"):
        model_of(replace(box, node_region=np.where(box.node_region == PLATE, 0, box.node_region)))
