"""A body whose energy is a polynomial is found again, for any number of chambers."""

import logging
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError
from softrl.core.polynomial import basis
from softrl.pod.fitting.basis import pod_basis
from softrl.pod.fitting.candidates import Candidates, Choice
from softrl.pod.fitting.energy import Weights, accumulate, scale_of, solve, trust
from softrl.pod.fitting.equilibria import equilibria
from softrl.pod.fitting.fit import fit_model, linear_model, tell_choice
from softrl.pod.fitting.map_fit import fit_maps, tell_symmetry
from softrl.pod.fitting.settling import equilibria_of
from softrl.pod.report import mass_errors, motions, orientation_errors, statics
from softrl.pod.step.tables import tables_of
from softrl.robots.robot import Robot
from tests.pod import synthetic
from tests.pod.conftest import SETTINGS
from tests.pod.mechanics import mechanical_energy
from tests.pod.synthetic import Law, law_of, synthetic_snapshots

Body = tuple[Robot, Snapshots, ReducedModel]


def test_unseen_equilibria_are_recovered(body: Body) -> None:
    robot, _, model = body
    unseen = equilibria(synthetic_snapshots(robot, 15, seed=99, trajectories=0))
    prediction, failed = statics(model, unseen)
    assert failed == 0
    assert prediction.tip_errors().max() < 1e-7, f"{prediction.tip_errors().max():g} m"
    assert prediction.volume_error() < 1e-6
    assert orientation_errors(model, unseen).max() < 1e-7


def test_the_energy_is_the_law(body: Body) -> None:
    robot, snapshots, model = body
    law = law_of(robot)
    found = mechanical_energy(model, snapshots.coordinate, np.zeros_like(snapshots.coordinate), np.zeros(3))
    expected = [law.energy(z) for z in snapshots.coordinate]
    np.testing.assert_allclose(found, expected, atol=1e-6 * max(expected))


def test_unseen_motion_is_recovered(body: Body) -> None:
    _, snapshots, model = body
    prediction = motions(model, snapshots)
    travel = np.linalg.norm(prediction.full[..., -3:], axis=-1).max()
    # half way of a step is that of its first iteration, where the law's own march takes the last
    assert prediction.tip_errors().max() < 1e-3 * travel
    assert motions(linear_model(model), snapshots).tip_errors().max() > 5.0 * prediction.tip_errors().max()


def test_amplitudes_know_all_of_the_mass(body: Body) -> None:
    """The centre's from its moments, what these leave as that at rest."""
    robot, snapshots, model = body
    unseen = equilibria(synthetic_snapshots(robot, 20, seed=11, trajectories=0))
    assert np.abs(mass_errors(model, unseen)).max() < 1e-4
    few = replace(model, amplitudes=model.amplitudes[-model.order :])
    assert np.abs(mass_errors(few, unseen)).max() > 0.1


class Lopsided(Law):
    """A body whose mass follows the tip farther along x than along y, unlike its chambers."""

    def centre_of_mass(self, z: np.ndarray) -> np.ndarray:
        return super().centre_of_mass(z) * np.array([1.6, 1.0, 1.0])


def test_a_body_without_the_symmetry_of_its_chambers_has_no_images(
    tripod: Body, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    robot, _, model = tripod
    settings = replace(SETTINGS, image_weights=(0.1, 1.0))
    monkeypatch.setattr(synthetic, "law_of", lambda robot: Lopsided(robot.chamber_direction))
    seen = synthetic_snapshots(robot, 40, seed=3, trajectories=0)
    unseen = equilibria(synthetic_snapshots(robot, 20, seed=11, trajectories=0))
    model = replace(model, **fit_maps(settings, robot, equilibria(seen), model.frame, np.arange(40) % 2))
    assert np.abs(mass_errors(model, unseen)).max() < 1e-3
    nearest = np.linalg.norm(seen.loads / np.abs(seen.loads).max(axis=0), axis=1).argmin()
    assert np.abs(mass_errors(model, equilibria(seen).rows([nearest]))).max() < 1e-5
    assert not caplog.records, "a fit may run in a worker, whose log is nobody's"
    tell_symmetry(robot, equilibria(seen), model.frame)
    assert "robot.chamber_angle_deg" in caplog.text and "without images" in caplog.text


def test_viscosity_is_that_under_the_weight(tripod: Body) -> None:
    robot, snapshots, model = tripod
    along_z, share = np.array([0.0, 0.0, 1.0])[:, None, None], 0.01  # a hundredth more by each m/s^2 along z
    seen = replace(snapshots, viscosity_by_gravity=share * along_z * snapshots.tangent_stiffness[:, None])
    fold = np.arange(len(snapshots.loads)) % 2
    model = replace(model, **fit_maps(SETTINGS, robot, equilibria(seen), model.frame, fold))
    values = basis(6, 4).values(np.linalg.solve(model.frame, snapshots.coordinate[:5].T).T)
    tables = [tables_of(model, np.array([1.0, 2.0, g])).stiffness_root for g in (0.0, 3.0)]
    root = np.zeros((2, 5, 6, 6))
    root[..., *np.triu_indices(6)] = [values[:, : table.shape[1]] @ table.T for table in tables]
    root += np.triu(root, 1).swapaxes(-1, -2)
    light, heavy = root @ root
    np.testing.assert_allclose(heavy, 1.03 * light, atol=2e-3 * np.abs(light).max())


def test_symmetry_spares_equilibria(tripod: Body) -> None:
    robot, _, _ = tripod
    few = synthetic_snapshots(robot, 6, seed=7, trajectories=0)  # three at a time: 84 equations, of 203 unknowns
    pod = pod_basis(few.displacement, few.nodal_mass, 0.9999, 8)
    model, choices = fit_model(replace(SETTINGS, ridges=(1e-13,)), robot, few, equilibria(few), pod, np.arange(6) % 2)
    by_weight = {c.image_weight: c.tip_error_m for c in choices if c.degree == 4}
    assert by_weight[1.0] < 0.01 * by_weight[0.0], by_weight
    assert model.symmetry == "all"


def test_third_derivatives_spare_equilibria(tripod: Body) -> None:
    robot, law = tripod[0], law_of(tripod[0])
    few = equilibria(synthetic_snapshots(robot, 5, seed=7, trajectories=0))  # 28 equations each, of 203 unknowns
    unseen, error = equilibria(synthetic_snapshots(robot, 15, seed=99, trajectories=0)), []
    frame = np.diag(2.0 * np.abs(unseen.coordinate).max(axis=0))
    rows = basis(6, 4).gradient_rows(np.linalg.solve(frame, unseen.coordinate.T).T)
    loads = np.array([law.gradient(z) for z in unseen.coordinate])
    for third in (0.0, 0.1):
        normal = accumulate(few, np.ones(5), frame, scale_of(few), 4, Weights(0.3, 0.3, third))
        found = rows @ solve(normal, 6, 4, 1e-13) @ np.linalg.inv(frame)
        error.append(np.abs((found - loads) / np.abs(loads).max(axis=0)).max())
    assert error[1] < 0.01 * error[0], error


def test_equilibria_that_no_polynomial_follows_spoil_no_others(tripod: Body) -> None:
    """Where walls fold, the energy need not be right, and must not be wrong elsewhere for it."""
    robot, law, weights = tripod[0], law_of(tripod[0]), Weights(0.3, 0.3, 0.1)
    samples = equilibria(synthetic_snapshots(robot, 40, seed=5, trajectories=0))
    folded = np.arange(40) >= 36
    samples = samples._replace(load=samples.load * np.where(folded, 1.5, 1.0)[:, None])
    unseen = equilibria(synthetic_snapshots(robot, 15, seed=99, trajectories=0))
    frame, scale = np.diag(2.0 * np.abs(unseen.coordinate).max(axis=0)), scale_of(samples)
    trusted = trust(samples, frame, scale, 4, weights)
    assert trusted[folded].max() < 0.01 < 0.1 < trusted[~folded].min()
    rows = basis(6, 4).gradient_rows(np.linalg.solve(frame, unseen.coordinate.T).T)
    loads = np.array([law.gradient(z) for z in unseen.coordinate])
    error = []
    for weight in (trusted, np.ones(40)):
        found = solve(accumulate(samples, weight, frame, scale, 4, weights), 6, 4, 1e-12)
        error.append(np.abs((rows @ found @ np.linalg.inv(frame) - loads) / np.abs(loads).max(axis=0)).max())
    assert error[0] < 0.1 * error[1], error


def test_anchors_are_the_equilibria_of_the_lower_degree(tripod: Body) -> None:
    robot, snapshots, model = tripod
    loads = snapshots.loads[:10]
    anchors = equilibria_of(model, loads)
    law = law_of(robot)
    np.testing.assert_allclose(anchors.load, loads, atol=1e-4)
    scale = np.abs(snapshots.slopes["compliance"]).max(axis=0)
    expected = np.array([law.slopes(z)["compliance"] for z in anchors.coordinate])
    assert (np.abs(anchors.slopes["compliance"] - expected) < 1e-3 * scale + 1e-30).all()


def test_too_few_equilibria_are_refused(tripod: Body) -> None:
    robot, snapshots, _ = tripod
    samples = equilibria(snapshots).rows(np.arange(1))
    pod = pod_basis(snapshots.displacement, snapshots.nodal_mass, 0.99, 4)
    with pytest.raises(ConfigError, match="1 equilibria are too few"):
        fit_model(SETTINGS, robot, snapshots, samples, pod, np.zeros(1, dtype=int))


def test_hardly_any_equilibria_make_a_linear_body_and_a_warning(tripod: Body, caplog: pytest.LogCaptureFixture) -> None:
    robot, snapshots, _ = tripod
    pod = pod_basis(snapshots.displacement, snapshots.nodal_mass, 0.99, 4)
    samples = equilibria(snapshots).rows(np.arange(5))
    model, choices = fit_model(
        replace(SETTINGS, energy_degree_max=2), robot, snapshots, samples, pod, np.arange(5) % 2
    )
    prediction, failed = statics(model, samples)
    assert failed == 0
    assert prediction.tip_errors().max() < np.linalg.norm(prediction.full[:, 3:], axis=1).max()
    assert not caplog.records, "a fit may be one of several that only judge"
    tell_choice(model, robot, samples, choices[0])
    (record,) = (record for record in caplog.records if record.levelno == logging.WARNING)
    assert "5 equilibria is stable at rest; the reduced model is linear" in record.getMessage()


def test_a_ridge_that_is_too_much_for_any_energy_is_not_the_only_one_tried(tripod: Body) -> None:
    """The middle one of two is the larger one."""
    robot, snapshots, _ = tripod
    pod = pod_basis(snapshots.displacement, snapshots.nodal_mass, 0.99, 4)
    settings = replace(SETTINGS, ridges=(1e-9, 1e-6))
    model, choices = fit_model(settings, robot, snapshots, equilibria(snapshots), pod, np.arange(40) % 2)
    assert choices[0].degree == 4 and choices[0].ridge == 1e-9, choices[0]
    unseen = equilibria(synthetic_snapshots(robot, 15, seed=99, trajectories=0))
    assert statics(model, unseen)[0].tip_errors().max() < 1e-5


def test_a_ridge_below_round_off_is_refused(tripod: Body) -> None:
    robot, snapshots, _ = tripod
    pod = pod_basis(snapshots.displacement, snapshots.nodal_mass, 0.99, 4)
    samples = equilibria(snapshots).rows(np.arange(3))
    with pytest.raises(ConfigError, match=r"stage\.ridges: 1e-15 is less than round-off"):
        fit_model(SETTINGS, robot, snapshots, samples, pod, np.arange(3) % 2)


def test_equations_of_one_weight_of_images_are_held_at_a_time(tripod: Body) -> None:
    """Those of four chambers at degree 8 have 0.3 GB each."""
    robot, snapshots, model = tripod
    settings = replace(SETTINGS, ridges=(1e-9,), image_weights=(0.01, 0.1, 1.0))
    candidates = Candidates(settings, robot, model, equilibria(snapshots), np.arange(40) % 2)
    first = candidates.energy(Choice(0.01, 0.0, 4, 1e-9, np.nan))
    matrix, held = 8 * (len(first) - 7) ** 2, []
    tracemalloc.start()
    for weight in (0.1, 1.0, 0.01):
        again = candidates.energy(Choice(weight, 0.0, 4, 1e-9, np.nan))
        held.append(tracemalloc.get_traced_memory()[0] / matrix)
    tracemalloc.stop()
    np.testing.assert_array_equal(again, first)
    assert max(held) < 1 + settings.folds + 0.5, held
