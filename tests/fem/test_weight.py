"""How an equilibrium bears weight: against differences, and what it predicts against the weighted body."""

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import diags
from scipy.sparse.linalg import LinearOperator, eigs, splu

from softrl.artifacts.mesh import Mesh
from softrl.fem.answers import answers_at, slopes_at
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent
from softrl.fem.weight import Weight, held_of, pull_at_rest, pull_of, swing_of, weight_of
from softrl.pod.fitting.equilibria import per_spin, rotation_vector
from tests.fem.bodies import hollow_box, model_of

LOAD = np.array([1.5e5, -1e4, 2.0, 1.0, -3.0])
GRAVITY = (30.0, 0.0, -90.0)


def centre(model: FemModel, pose: Pose) -> np.ndarray:
    return model.moments(pose.position - model.solid.points)[0] / model.nodal_mass.sum()


def centre_slope(model: FemModel, tangent: Tangent) -> np.ndarray:
    return model.moments(tangent.shapes)[:, 0].T / model.nodal_mass.sum()


def centre_and_turn(model: FemModel, load: np.ndarray) -> np.ndarray:
    pose = model.static(load).pose
    return np.r_[centre(model, pose), rotation_vector(model.tip_quaternion(pose)[None])[0]]


def bears(model: FemModel, pose: Pose, tangent: Tangent) -> Weight:
    forces = np.hstack([pull_of(model, pose), swing_of(model, pose, tangent)])
    return weight_of(model, pose, tangent, forces, held_of(model, pose, tangent, model.solve(forces)))


def test_slopes_are_those_of_neighbouring_equilibria(box: Mesh) -> None:
    model = model_of(box)
    pose = model.static(LOAD).pose
    tangent = model.tangent(pose, LOAD)
    weight = bears(model, pose, tangent)
    turn = per_spin(rotation_vector(model.tip_quaternion(pose)[None]))[0]
    for k, step in enumerate((200.0, 200.0, 0.02, 0.02, 0.02)):
        nudge = step * np.eye(5)[k]
        change = (centre_and_turn(model, LOAD + nudge) - centre_and_turn(model, LOAD - nudge)) / (2.0 * step)
        told = np.r_[centre_slope(model, tangent)[:, k], turn @ weight.tip_spin[:, k]]
        for part in (slice(0, 3), slice(3, 6)):
            np.testing.assert_allclose(told[part], change[part], atol=2e-3 * np.abs(change[part]).max())


def test_a_load_that_pulls_like_the_weight_leaves_what_gives_way(box: Mesh) -> None:
    """With volumes and tip where the weighted body has them, the plain one misses its centre of mass by the give."""
    model, heavy = model_of(box), model_of(box, gravity_m_s2=GRAVITY)
    gravity, mass = np.array(GRAVITY), model.nodal_mass.sum()
    weighed = heavy.static(LOAD).pose
    wanted, load = heavy.coordinate(weighed), LOAD
    for _ in range(6):  # the load that holds the plain body's volumes and tip where the weighted body's are
        pose = model.static(load).pose
        tangent = model.tangent(pose, load)
        load = load + np.linalg.solve(tangent.compliance, wanted - model.coordinate(pose))
    weight = bears(model, pose, tangent)
    left = mass * (centre(heavy, weighed) - centre(model, pose))
    np.testing.assert_allclose(left, weight.give @ gravity, atol=0.1 * np.abs(left).max())
    assert np.linalg.eigvalsh(weight.give).min() > 0.0
    pulled = np.linalg.solve(tangent.compliance, mass * gravity @ centre_slope(model, tangent))
    scale = np.r_[np.full(2, 1e4), np.ones(3)]
    missed, all_of_it = (load - LOAD - pulled) / scale, (load - LOAD) / scale
    assert np.linalg.norm(missed) < 0.1 * np.linalg.norm(all_of_it)


def test_the_pull_at_rest_sags_the_body_like_its_weight(box: Mesh) -> None:
    light = (0.3, 0.0, -0.9)
    model, heavy = model_of(box), model_of(box, gravity_m_s2=light)
    sag = heavy.coordinate(heavy.static(np.zeros(5)).pose)
    pulled = model.coordinate(model.static(pull_at_rest(model, np.array(light))).pose)
    np.testing.assert_allclose(pulled[2:], sag[2:], atol=1e-3 * np.abs(sag[2:]).max())


def test_viscosity_changes_as_the_body_gives(box: Mesh) -> None:
    model = model_of(box)
    pose = model.static(LOAD).pose
    tangent, wanted, pull = model.tangent(pose, LOAD), model.coordinate(pose), np.array([3.0, 1.0, -6.0])
    _, told = slopes_at(model, pose, LOAD, tangent, answers_at(model, pose, tangent, model.solve))
    found = per_coordinate(np.tensordot(pull, told, axes=1), tangent)
    ahead, behind = (viscosity_under(sign * pull, wanted) for sign in (1.0, -1.0))
    expected, scale = 0.5 * (ahead - behind), np.sqrt(np.outer(np.diag(ahead), np.diag(ahead)))
    assert np.abs((found - expected) / scale).max() < 0.02 * np.abs(expected / scale).max()


def test_with_what_the_inside_gives_slow_swings_take_their_time(box: Mesh) -> None:
    """The two slowest natural vibrations around an equilibrium: of few coordinates and the inside, against all nodes."""
    model = model_of(box)
    pose = model.static(LOAD).pose
    tangent = model.tangent(pose, LOAD)
    weight, inverse = bears(model, pose, tangent), np.linalg.inv(tangent.compliance)
    couple, mass = inverse @ weight.inner_coupling.T, inverse @ tangent.mass @ inverse
    stiffness = np.block([[inverse, np.zeros((5, 6))], [np.zeros((6, 5)), weight.inner_give]])
    heavy = np.block([[mass, couple], [couple.T, weight.inner_mass]])
    expected = 1.0 / periods_squared(model, pose, 2)
    alone, found = eigh(inverse, mass)[0][:2], eigh(stiffness, heavy)[0][:2]
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert (np.abs(alone - expected) > 10.0 * np.abs(found - expected)).all()


def test_with_what_the_inside_gives_a_shaken_tip_is_damped_as_by_all_nodes(box: Mesh) -> None:
    """The answer to tip forces that swing as fast as damping lets the body creep: of few coordinates and the inside."""
    model, pace, rate = model_of(box), 2e-2, 50.0
    pose = model.static(LOAD).pose
    tangent = model.tangent(pose, LOAD)
    weight, inverse = bears(model, pose, tangent), np.linalg.inv(tangent.compliance)

    def swung(shapes: slice) -> np.ndarray:
        across, own = -(rate**2) * weight.inner_coupling, -(rate**2) * weight.inner_mass + weight.inner_give
        across = (across + 1j * rate * pace * weight.inner_drag)[shapes] @ inverse
        own = (own + 1j * rate * pace * weight.inner_viscosity)[shapes, shapes]
        held = inverse + inverse @ (1j * rate * pace * tangent.stiffness - rate**2 * tangent.mass) @ inverse
        return np.asarray(np.linalg.inv(held - across.T @ np.linalg.solve(own, across))[:, -3:])

    expected, scale = shaken(model, pose, pace, rate), np.sqrt(np.diag(tangent.compliance))[:, None]
    inert, both = (np.abs((swung(part) - expected) / scale).max() for part in (slice(0, 3), slice(0, 6)))
    assert both < 2e-5 * np.abs(expected / scale).max()
    assert both < 0.05 * inert  # three shapes that give to inertia do not hold what damping asks of the inside


def shaken(model: FemModel, pose: Pose, pace: float, rate: float) -> np.ndarray:
    """Return the answers (n + 3, 3) m^3/N and m/N of all nodes to tip forces at ``rate``, 1/s, damped by ``pace`` s."""
    stiffness, blocks = model.stiffness(pose, LOAD), model.viscous(pose)
    damping = model.coupling.stiffness(blocks, np.zeros_like(pose.position), pose)
    blocks = np.zeros_like(blocks)
    blocks[model.pairs.diagonal] = model.nodal_mass[:, None, None] * np.eye(3)
    mass = model.coupling.stiffness(blocks, np.zeros_like(pose.position), pose)
    upper = stiffness + 1j * rate * pace * damping - rate**2 * mass
    whole = upper + upper.T - diags(upper.diagonal())
    forces = model.load_directions(pose)
    return np.asarray(forces.T @ splu(whole.tocsc()).solve(forces[:, -3:].astype(complex)))


def periods_squared(model: FemModel, pose: Pose, count: int) -> np.ndarray:
    """Return the largest eigenvalues (count,) s^2 of compliance times mass, largest first."""

    def swung(x: np.ndarray) -> np.ndarray:
        moved = model.coupling.expand(x.ravel(), pose)
        return model.solve(model.coupling.reduce(model.nodal_mass[:, None] * moved, pose)[:, None])[:, 0]

    size = len(pull_of(model, pose))
    values = eigs(LinearOperator((size, size), matvec=swung), count, v0=np.ones(size), return_eigenvectors=False)
    return np.sort(values.real)[::-1]


def viscosity_under(gravity: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the viscosity by the coordinates, held at ``wanted``, of the box under ``gravity``."""
    model, load = model_of(hollow_box(chambers=2), gravity_m_s2=tuple(gravity)), LOAD
    for _ in range(8):
        pose = model.static(load).pose
        tangent = model.tangent(pose, load)
        load = load + np.linalg.solve(tangent.compliance, wanted - model.coordinate(pose))
    return per_coordinate(tangent.stiffness, tangent)


def per_coordinate(matrix: np.ndarray, tangent: Tangent) -> np.ndarray:
    inverse = np.linalg.inv(tangent.compliance)
    return inverse @ matrix @ inverse
