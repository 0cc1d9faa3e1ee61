"""POD Galerkin against the full model whose equations it projects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.snapshots import Snapshots
from softrl.bench.rom import RomBench
from softrl.bench.watch import Watch
from softrl.core import fingerprint
from softrl.core.errors import ConfigError, SolverError
from softrl.core.tracking import NullTracker
from softrl.fem.law import STRESS, TANGENT
from softrl.fem.material import StableNeoHookean
from softrl.fem.stage import run as run_fem
from softrl.pod.galerkin.hyperreduction import sample_elements
from softrl.pod.galerkin.model import GalerkinBody, build_body, elastic, full_displacements
from softrl.pod.galerkin.simulator import GalerkinSimulator
from softrl.pod.simulator import RomSimulator
from tests.bench.full import full_simulator
from tests.fem.bodies import box_robot, hollow_box, model_of
from tests.fem.test_stage import CONFIG
from tests.pod.conftest import fitted

BOX, LAW = hollow_box(chambers=2), StableNeoHookean(1e6, 0.45)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("galerkin")


@pytest.fixture(scope="module")
def snapshots(folder: Path) -> Snapshots:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return run_fem(CONFIG, box_robot(2), BOX, tracker=NullTracker())


@pytest.fixture(scope="module")
def simulator(snapshots: Snapshots, folder: Path) -> GalerkinSimulator:
    made = GalerkinSimulator(
        robot=box_robot(2), mesh=BOX, snapshots=snapshots, modes=12, training_snapshots=6, training_motion_s=0.02,
        hold_s=0.01, dt_s=0.002, ecsw_tolerance=1e-3,
        ecsw_elements=200, seed=0, youngs_modulus_scale=1.0, damping_scale=1.0, mass_scale=1.0,
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert made.body.elements < len(BOX.tetrahedra)
        again = made.with_parameters(mass_scale=2.0)
        assert again.body is made.body
    return made


def test_a_body_is_built_anew_where_code_that_made_it_has_changed(
    simulator: GalerkinSimulator, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of the training motion, for one."""
    read, built = fingerprint._source, []

    def build(this: GalerkinSimulator) -> GalerkinBody:
        built.append(this)
        return simulator.body

    monkeypatch.chdir(folder)
    monkeypatch.setattr(GalerkinSimulator, "_build", build)
    assert replace(simulator).body.elements == simulator.body.elements and not built
    monkeypatch.setattr(fingerprint, "_source", lambda module: read(module) + "#" * (module == "softrl.fem.sampling"))
    assert replace(simulator).body.elements == simulator.body.elements and built


def test_the_bench_tells_how_long_a_body_takes_to_build_only_where_it_does(
    simulator: GalerkinSimulator, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, snapshots, model = fitted(2)
    rom, loads = RomSimulator(robot, model, 1.0, 1.0, 1.0), [np.zeros((2, 5))]
    told = []
    monkeypatch.setattr(GalerkinSimulator, "_build", lambda this: simulator.body)
    for place in (folder, tmp_path):
        monkeypatch.chdir(place)
        settings = (1, 0, 0, 0, {}, 0.2, 0.1, 0.01, 10, 1, 10)
        bench = RomBench(rom, replace(simulator), None, None, *settings, snapshots)  # type: ignore[arg-type]
        told.append("galerkin_build_s" in bench._galerkin(Watch(1), loads)[1])
    assert told == [False, True]


def test_all_nodes_are_found_again_from_the_corners(snapshots: Snapshots) -> None:
    model = model_of(BOX)
    found = full_displacements(model, snapshots.loads[:2], snapshots.displacement[:2])
    assert np.abs(found[:, : len(BOX.points)] - snapshots.displacement[:2]).max() < 1e-7
    straight = found[:, model.solid.edge_ends].mean(axis=2)
    assert np.abs(found[:, model.solid.corners :] - straight).max() > 1e-6, "edges do bend"


@pytest.mark.parametrize("bulk_pa", [0.0, 4e6])
def test_forces_and_stiffness_are_derivatives_of_the_energy(snapshots: Snapshots, bulk_pa: float) -> None:
    model = model_of(BOX)
    displacement = full_displacements(model, snapshots.loads, snapshots.displacement)
    made = build_body(model, LAW, displacement, 4, 1e-6, 10**6, len(displacement))
    made = made._replace(bulk_pa=bulk_pa)
    q = 0.3 * np.linalg.norm(displacement[0]) * np.random.default_rng(0).standard_normal(4) * 1e-2
    gradient, hessian, scratch = np.zeros(4), np.zeros((4, 4)), np.zeros((4, 4))

    def energy(at: np.ndarray, order: int = STRESS) -> float:
        return elastic(type(LAW).kernel, made.law_parameters, made.bulk_pa, made.slope, made.weight, at, order, gradient, scratch)

    elastic(type(LAW).kernel, made.law_parameters, made.bulk_pa, made.slope, made.weight, q, TANGENT, gradient, hessian)
    forward = gradient.copy()
    step = 1e-5 * np.linalg.norm(q)
    slope = [(energy(q + step * e) - energy(q - step * e)) / (2 * step) for e in np.eye(4)]
    np.testing.assert_allclose(forward, slope, rtol=1e-5, atol=1e-7 * np.abs(forward).max())
    columns = []
    for e in np.eye(4):
        energy(q + step * e)
        ahead = gradient.copy()
        energy(q - step * e)
        columns.append((ahead - gradient) / (2 * step))
    np.testing.assert_allclose(hessian, np.array(columns), rtol=1e-4, atol=1e-6 * np.abs(hessian).max())


def test_volume_and_tip_are_those_of_the_nodes(simulator: GalerkinSimulator, snapshots: Snapshots) -> None:
    for row in range(3):
        state = simulator.with_parameters(mass_scale=1e-9)._settle(snapshots.loads[row])
        found = simulator._state(state, np.zeros_like(state)).coordinates
        moved = np.abs(snapshots.coordinate).max(axis=0)
        assert np.abs((found - snapshots.coordinate[row]) / moved).max() < 0.05


def test_its_motion_is_near_the_full_models(simulator: GalerkinSimulator, snapshots: Snapshots) -> None:
    full = full_simulator(
        simulator.robot, BOX, rayleigh_mass_per_s=snapshots.rayleigh_mass_per_s,
        rayleigh_stiffness_s=snapshots.rayleigh_stiffness_s, tolerance_m=1e-8,
    )  # fmt: skip
    time = 0.002 * np.arange(1, 7)
    pressure = np.tile([8e3, -2e3], (6, 1))
    ours, theirs = simulator.simulate(time, pressure), full.simulate(time, pressure)
    moved = np.abs(theirs.position - theirs.position[0]).max()
    assert np.abs(ours.position - theirs.position).max() < 0.1 * moved
    assert np.abs(np.linalg.norm(ours.quaternion, axis=1) - 1.0).max() < 1e-12


def test_unforced_energy_falls(simulator: GalerkinSimulator) -> None:
    light = simulator.with_parameters(mass_scale=1e-3)
    state = light._state(light._settle(np.array([8e3, 0.0, 0.0, 0.0, 0.0])), np.zeros(light.body.slope.shape[3]))
    energies = []
    for _ in range(10):
        state = light.step(state, np.zeros(2), 0.002)
        scratch = np.zeros(len(state.amplitude)), np.zeros((len(state.amplitude),) * 2)
        body = light.body
        held = (type(LAW).kernel, body.law_parameters, body.bulk_pa, body.slope, body.weight)
        stored = elastic(*held, state.amplitude, 0, *scratch)
        energies.append(stored + 0.5e-3 * float(state.velocity @ state.velocity))
    assert (np.diff(energies) < 1e-9).all()


def test_few_elements_do_the_work_of_all() -> None:
    rng = np.random.default_rng(1)
    work = rng.standard_normal((40, 3)) @ rng.random((3, 300)) + 0.01 * rng.standard_normal((40, 300))
    found = sample_elements(work, 0.02, 100)
    assert (found.weights > 0.0).all() and len(found.elements) <= 60
    error = np.linalg.norm(work[:, found.elements] @ found.weights - work.sum(axis=1)) / np.linalg.norm(work.sum(axis=1))
    assert error == pytest.approx(found.error) and error <= 0.02
    with pytest.raises(SolverError, match="allow more elements"):
        sample_elements(rng.standard_normal((40, 300)), 1e-9, 8)


def test_effects_inside_the_body_are_refused(simulator: GalerkinSimulator) -> None:
    with pytest.raises(ConfigError, match="choose simulator=rom"):
        simulator.step(simulator.reset(), np.zeros(2), 0.01, None, [object()])  # type: ignore[list-item]
