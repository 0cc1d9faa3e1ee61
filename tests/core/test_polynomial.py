"""Tables of monomials: derivatives against finite differences, and the numbering by degree."""

import numpy as np
import pytest

from softrl.core.polynomial import basis, count, degree_of, multinomials

STEP = 1e-6


@pytest.mark.parametrize(("variables", "degree"), [(4, 5), (6, 3)])
def test_derivatives_agree_with_differences(variables: int, degree: int) -> None:
    rng, table = np.random.default_rng(0), basis(variables, degree)
    point, coefficients = rng.uniform(-1, 1, (1, variables)), rng.standard_normal(table.monomials)

    def value(at: np.ndarray) -> float:
        return float(table.values(at)[0] @ coefficients)

    def gradient(at: np.ndarray) -> np.ndarray:
        return table.gradient_rows(at)[0] @ coefficients

    units = STEP * np.eye(variables)
    by_difference = [(value(point + unit) - value(point - unit)) / (2 * STEP) for unit in units]
    np.testing.assert_allclose(gradient(point), by_difference, rtol=1e-6, atol=1e-8)
    bent = np.array([(gradient(point + unit) - gradient(point - unit)) / (2 * STEP) for unit in units])
    np.testing.assert_allclose(table.hessian_rows(point)[0] @ coefficients, bent, rtol=1e-6, atol=1e-8)
    turned = np.array([(table.hessian_rows(point + unit)[0] - table.hessian_rows(point - unit)[0]) @ coefficients
                       for unit in units]) / (2 * STEP)  # fmt: skip
    np.testing.assert_allclose(table.third_rows(point)[0] @ coefficients, turned, rtol=1e-6, atol=1e-7)
    lower, lowest = basis(variables, degree - 1), basis(variables, degree - 2)
    np.testing.assert_allclose(
        lower.values(point) @ table.derivative(coefficients).T, gradient(point)[None], atol=1e-12
    )
    np.testing.assert_allclose(
        table.hessian(coefficients) @ lowest.values(point)[0], bent[np.triu_indices(variables)], rtol=1e-6, atol=1e-8
    )


def test_lower_degrees_come_first() -> None:
    point = np.random.default_rng(1).uniform(-1, 1, (3, 6))
    np.testing.assert_array_equal(basis(6, 5).values(point)[:, : count(6, 3)], basis(6, 3).values(point))
    assert degree_of(6, count(6, 5)) == 5
    with pytest.raises(ValueError, match="fill no degree"):
        degree_of(6, 5)


def test_multinomials_expand_a_power_of_a_sum() -> None:
    point, table = np.array([[0.3, -1.2, 0.7]]), basis(3, 5)
    terms = (multinomials(3, 5) * table.values(point)[0])[table.degrees == 5]
    assert abs(terms.sum() - point.sum() ** 5) < 1e-15 * np.abs(terms).sum(), "round-off of the terms, which cancel"
