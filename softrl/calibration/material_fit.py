"""Incompressible hyperelastic laws fitted to a uniaxial tensile curve by bounded linear least squares.

Every law is an energy W(I1, I2); its nominal stress in a homogeneous test is ``2 (s - s^-a)(W_1 + g W_2)`` with the
stretch s, and a, g, I1 by the mode of deformation (uniaxial: a = 2, g = 1/s, I1 = s^2 + 2/s). W_1 and W_2 are linear in
the parameters of the three laws here, so each fit is one linear problem. Bounds keep the law usable in other modes of
deformation: unbounded fits of stiffening rubbers have a negative c2 (Mooney-Rivlin) or c3 (Yeoh) and collapse when
inflated; the price is that Mooney-Rivlin then stiffens no more than Neo-Hookean does.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from softrl.calibration.tensile import TensileCurve
from softrl.core.errors import ConfigError


class Mode(NamedTuple):
    """A homogeneous test: exponent a, factor g of W_2 and invariant I1, all by stretch."""

    exponent: float
    second_factor: Callable[[np.ndarray], np.ndarray]
    first_invariant: Callable[[np.ndarray], np.ndarray]


class Law(NamedTuple):
    """Names of the parameters (Pa), their least values, and the columns of W_1 and W_2 by I1 - 3."""

    parameters: tuple[str, ...]
    least: tuple[float, ...]
    first: Callable[[np.ndarray], list[np.ndarray]]
    second: Callable[[np.ndarray], list[np.ndarray]]


MISSED_FACTOR = 1.5  # times the best law's held-out error: a law that errs by more misses something
MODES = {
    "uniaxial": Mode(2.0, lambda s: 1.0 / s, lambda s: s**2 + 2.0 / s),
    "equibiaxial": Mode(5.0, lambda s: s**2, lambda s: 2.0 * s**2 + s**-4),
    "planar": Mode(3.0, lambda s: np.ones_like(s), lambda s: s**2 + s**-2 + 1.0),
}
LAWS = {
    "neo_hookean": Law(("mu_pa",), (0.0,), lambda j: [0.5 + 0 * j], lambda j: [0 * j]),
    "mooney_rivlin": Law(("c1_pa", "c2_pa"), (0.0, 0.0), lambda j: [1 + 0 * j, 0 * j], lambda j: [0 * j, 1 + 0 * j]),
    "yeoh": Law(
        ("c1_pa", "c2_pa", "c3_pa"),
        (0.0, -np.inf, 0.0),
        lambda j: [1 + 0 * j, 2 * j, 3 * j**2],
        lambda j: [0 * j, 0 * j, 0 * j],
    ),
}


@dataclass(frozen=True)
class MaterialFit:
    """One law fitted to one curve.

    Attributes
    ----------
    parameters : name -> Pa
    initial_youngs_modulus_pa : three times the initial shear modulus
    fit_rms_pa, heldout_rms_pa : error of the nominal stress on the fitted and on the held-out blocks of stretch
    extrapolation_rms_pa : error above the middle stretch when fitted below it
    stable : stress rises with stretch in uniaxial, equibiaxial and planar tests over the fitted range and its inverse
    """

    law: str
    parameters: dict[str, float]
    initial_youngs_modulus_pa: float
    fit_rms_pa: float
    heldout_rms_pa: float
    extrapolation_rms_pa: float
    stable: bool


def stress_basis(law: str, stretch: np.ndarray, mode: str = "uniaxial") -> np.ndarray:
    """Return (samples, parameters): nominal stress per unit of each parameter of ``law``."""
    test, terms = MODES[mode], LAWS[law]
    above = test.first_invariant(stretch) - 3.0
    first, second = np.stack(terms.first(above), -1), np.stack(terms.second(above), -1)
    shape = 2.0 * (stretch - stretch**-test.exponent)
    return shape[:, None] * (first + test.second_factor(stretch)[:, None] * second)


def nominal_stress(law: str, parameters: dict[str, float], stretch: np.ndarray, mode: str = "uniaxial") -> np.ndarray:
    """Return the nominal stress (samples,) in Pa of an incompressible specimen at ``stretch`` (samples,)."""
    return stress_basis(law, stretch, mode) @ np.array([parameters[name] for name in LAWS[law].parameters])


def fit_materials(curve: TensileCurve, blocks: int) -> list[MaterialFit]:
    """Return the fits of all laws; every second of ``blocks`` equal blocks of the curve is held out."""
    stretch, stress = curve.stretch, curve.stress
    if len(stretch) < 2 * blocks:
        raise ConfigError(
            f"stage.stretch_max leaves {len(stretch)} points of the tensile curve for stage.curve_blocks={blocks}; "
            f"expected at least {2 * blocks} points"
        )
    heldout = held_out(curve, blocks)
    return [_fit(law, stretch, stress, heldout) for law in LAWS]


def held_out(curve: TensileCurve, blocks: int) -> np.ndarray:
    """Return which points (samples,) of the curve no fit sees: every second of ``blocks`` equal blocks."""
    return np.asarray((np.arange(len(curve.stretch)) * blocks // len(curve.stretch)) % 2 == 1)


def fit_lower_half(law: str, curve: TensileCurve) -> tuple[dict[str, float], float]:
    """Return the parameters (Pa) of ``law`` fitted below the middle stretch only, and that stretch."""
    middle = 0.5 * float(curve.stretch[0] + curve.stretch[-1])
    low = curve.stretch <= middle
    return _least_squares(law, curve.stretch[low], curve.stress[low]), middle


def _fit(law: str, stretch: np.ndarray, stress: np.ndarray, heldout: np.ndarray) -> MaterialFit:
    solve = _least_squares(law, stretch[~heldout], stress[~heldout])
    error = nominal_stress(law, solve, stretch) - stress
    lower, middle = fit_lower_half(law, TensileCurve(stretch, stress))
    above = stretch > middle
    beyond = nominal_stress(law, lower, stretch[above]) - stress[above]
    slope = nominal_stress(law, solve, np.array([1.0 + 1e-6]))[0] / 1e-6
    return MaterialFit(
        law,
        solve,
        float(slope),
        _rms(error[~heldout]),
        _rms(error[heldout]),
        _rms(beyond),
        _stable(law, solve, stretch),
    )


def _least_squares(law: str, stretch: np.ndarray, stress: np.ndarray) -> dict[str, float]:
    basis = stress_basis(law, stretch)
    size = np.linalg.norm(basis, axis=0)
    values = lsq_linear(basis / size, stress, (LAWS[law].least, np.inf)).x / size
    return {name: float(value) for name, value in zip(LAWS[law].parameters, values, strict=True)}


def _stable(law: str, parameters: dict[str, float], stretch: np.ndarray) -> bool:
    reach = np.geomspace(1.0 / stretch[-1], stretch[-1], 200)
    return all(bool((np.diff(nominal_stress(law, parameters, reach, mode)) > 0.0).all()) for mode in MODES)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def best_fit(fits: list[MaterialFit]) -> MaterialFit:
    """Return the stable fit with the smallest held-out error (any fit if none is stable)."""
    return min(fits, key=lambda fit: (not fit.stable, fit.heldout_rms_pa))


def in_words(curve: TensileCurve, fits: list[MaterialFit]) -> str:
    """Return what a Neo-Hookean law misses on this curve, and what the best law makes of it, in one line."""
    plain, best = next(fit for fit in fits if fit.law == "neo_hookean"), best_fit(fits)
    if plain.heldout_rms_pa < MISSED_FACTOR * best.heldout_rms_pa:
        return (
            f"A Neo-Hookean law suffices up to stretch {curve.stretch[-1]:.2f}: held out it errs by "
            f"{plain.heldout_rms_pa / 1e3:.3g} kPa, {best.law} by {best.heldout_rms_pa / 1e3:.3g} kPa."
        )
    top = slice(-max(len(curve.stretch) // 20, 1), None)
    measured = float(curve.stress[top].mean())
    given = float(nominal_stress(plain.law, plain.parameters, curve.stretch[top]).mean())
    what = "strain stiffening" if given < measured else "softening with strain"
    below, further = plain.extrapolation_rms_pa / 1e3, best.extrapolation_rms_pa / 1e3
    return (
        f"A Neo-Hookean law misses the {what} of this material: at stretch {curve.stretch[top].mean():.2f} it gives "
        f"{given / 1e3:.3g} kPa where {measured / 1e3:.3g} kPa were measured. On the half of the curve held out it errs by "
        f"{plain.heldout_rms_pa / 1e3:.3g} kPa, {best.law} by {best.heldout_rms_pa / 1e3:.3g} kPa; on the upper half, "
        f"fitted to the lower one only, by {below:.3g} and {further:.3g} kPa"
        + (": no law may be trusted beyond the stretch it was fitted to." if further > below else ".")
    )


def as_record(fits: list[MaterialFit]) -> dict[str, Any]:
    """Return the fits as plain values by law, with the chosen one under ``chosen``."""
    return {fit.law: asdict(fit) for fit in fits} | {"chosen": best_fit(fits).law}
