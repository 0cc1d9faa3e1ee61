"""POD: orthonormal in the masses, best for its number of modes, exact on its span."""

import numpy as np

from softrl.pod.fitting.basis import pod_basis, projection_errors


def snapshots(samples: int = 30, nodes: int = 50, rank: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements (samples, nodes, 3) of falling amplitudes and nodal masses."""
    rng = np.random.default_rng(0)
    shapes = rng.standard_normal((rank, nodes, 3))
    amplitude = rng.standard_normal((samples, rank)) * 0.3 ** np.arange(rank)
    return np.einsum("sk,kni->sni", amplitude, shapes), rng.uniform(0.5, 2.0, nodes)


def test_modes_are_orthonormal_in_the_masses() -> None:
    displacement, mass = snapshots()
    basis = pod_basis(displacement, mass, 1.0, 20)
    gramian = np.einsum("ani,n,bni->ab", basis.modes, mass, basis.modes)
    np.testing.assert_allclose(gramian, np.eye(len(gramian)), atol=1e-12)


def test_the_error_left_is_the_singular_values_left() -> None:
    displacement, mass = snapshots()
    basis = pod_basis(displacement, mass, 1.0, 4)
    errors = projection_errors(basis, displacement, mass)
    expected = [np.sqrt((basis.singular_values[k:] ** 2).sum() / len(displacement) / mass.sum()) for k in range(5)]
    np.testing.assert_allclose(errors, expected, rtol=1e-8)


def test_all_of_the_rank_reproduces_the_snapshots() -> None:
    displacement, mass = snapshots(rank=6)
    basis = pod_basis(displacement, mass, 1.0, 20)
    assert len(basis.modes) == 6
    assert projection_errors(basis, displacement, mass)[-1] < 1e-7 * np.abs(displacement).max()


def test_the_energy_criterion_keeps_as_few_modes_as_it_asks() -> None:
    displacement, mass = snapshots()
    full = pod_basis(displacement, mass, 1.0, 20).singular_values
    share = np.cumsum(full**2) / (full**2).sum()
    kept = len(pod_basis(displacement, mass, 0.999, 20).modes)
    assert share[kept - 1] >= 0.999 > share[kept - 2]
