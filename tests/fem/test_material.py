"""Laws of the hyperelastic kernels."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError
from softrl.fem.law import ENERGY, TANGENT
from softrl.fem.material import (
    LAWS,
    Corotational,
    Material,
    MooneyRivlin,
    StableNeoHookean,
    StVenantKirchhoff,
    Yeoh,
    lame,
    material_of,
)

MATERIALS = [
    StableNeoHookean(1.2e6, 0.45), StVenantKirchhoff(1.2e6, 0.4), Yeoh(2e5, 4e4, 1e4, 0.45),
    MooneyRivlin(1.5e5, 6e4, 0.45), Corotational(1.2e6, 0.45),
]
all_laws = pytest.mark.parametrize("material", MATERIALS, ids=lambda m: type(m).__name__)


def evaluate(material: Material, gradient: np.ndarray, order: int = TANGENT) -> tuple[float, np.ndarray, np.ndarray]:
    """Return energy density, stress (3, 3) and tangent (9, 9)."""
    stress, tangent = np.zeros((3, 3)), np.zeros((9, 9))
    energy = type(material).kernel(material.pack(), np.ascontiguousarray(gradient), stress, tangent, order)
    return energy, stress, tangent


def deformation(seed: int, size: float = 0.2) -> np.ndarray:
    """Return a deformation gradient with positive determinant."""
    return np.eye(3) + size * np.random.default_rng(seed).standard_normal((3, 3))


@all_laws
def test_stress_is_the_gradient_of_energy_and_tangent_that_of_stress(material: Material) -> None:
    at, step = deformation(1), 1e-6
    _, stress, tangent = evaluate(material, at)
    numeric_stress, numeric_tangent = np.zeros((3, 3)), np.zeros((9, 9))
    for k, unit in enumerate(np.eye(9).reshape(9, 3, 3)):
        above, below = evaluate(material, at + step * unit), evaluate(material, at - step * unit)
        numeric_stress[k // 3, k % 3] = (above[0] - below[0]) / (2 * step)
        numeric_tangent[:, k] = (above[1] - below[1]).ravel() / (2 * step)
    assert np.abs(stress - numeric_stress).max() < 1e-7 * np.abs(stress).max()
    assert np.abs(tangent - numeric_tangent).max() < 1e-7 * np.abs(tangent).max()


@all_laws
def test_rest_is_free_of_stress_and_linear_elastic_near_it(material: Material) -> None:
    energy, stress, tangent = evaluate(material, np.eye(3))
    scale = material.youngs_modulus_pa
    assert abs(energy) < 1e-9 * scale
    assert np.abs(stress).max() < 1e-9 * scale
    lam, mu = lame(material.youngs_modulus_pa, material.poisson)
    strain = np.random.default_rng(0).standard_normal((3, 3))
    strain = 0.5 * (strain + strain.T)
    hooke = lam * np.trace(strain) * np.eye(3) + 2 * mu * strain
    assert np.allclose(tangent @ strain.ravel(), hooke.ravel(), atol=1e-9 * scale)


@all_laws
def test_energy_does_not_see_a_rotation_and_the_law_is_isotropic(material: Material) -> None:
    at, turn = deformation(2), Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    energy = evaluate(material, at, ENERGY)[0]
    assert evaluate(material, turn @ at, ENERGY)[0] == pytest.approx(energy, rel=1e-12)
    assert evaluate(material, at @ turn, ENERGY)[0] == pytest.approx(energy, rel=1e-12)


@all_laws
def test_tangent_is_symmetric(material: Material) -> None:
    tangent = evaluate(material, deformation(4))[2]
    assert np.abs(tangent - tangent.T).max() < 1e-12 * np.abs(tangent).max()


def test_yeoh_follows_the_textbook_curve_in_uniaxial_tension() -> None:
    c1, c2, c3, stretch = 2e5, 4e4, 1e4, 1.3
    across = stretch**-0.5  # volume kept, so the pressure is a free multiplier
    stress = evaluate(Yeoh(c1, c2, c3, 0.45), np.diag([stretch, across, across]))[1]
    nominal = stress[0, 0] - stress[1, 1] * across / stretch
    x = stretch**2 + 2 / stretch - 3
    expected = 2 * (stretch - stretch**-2) * (c1 + 2 * c2 * x + 3 * c3 * x**2)
    assert nominal == pytest.approx(expected, rel=1e-10)


def test_bad_moduli_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"0\.495"):
        StableNeoHookean(1e6, 0.4999)
    with pytest.raises(ConfigError, match="positive"):
        material_of("stable_neo_hookean", [-1.0], 0.4)
    with pytest.raises(ConfigError, match="takes c1_pa, c2_pa, c3_pa"):
        material_of("yeoh", [1e5], 0.4)
    with pytest.raises(ConfigError, match="expected one of"):
        material_of("hooke", [1e5], 0.4)
    assert set(LAWS) == {"stable_neo_hookean", "st_venant_kirchhoff", "corotational", "yeoh", "mooney_rivlin"}
