"""Figures of the calibration: tensile fits, and the pressure map against held-out holds."""

import numpy as np
from matplotlib.figure import Figure

from softrl.calibration.material_fit import MaterialFit, fit_lower_half, nominal_stress
from softrl.calibration.tensile import TensileCurve

# laws may coincide (Mooney-Rivlin at its bound is Neo-Hookean), so the later ones leave gaps
STYLES = ("C0-", "C1--", "C2-")


def draw_tensile(curve: TensileCurve, fits: list[MaterialFit], heldout: np.ndarray) -> Figure:
    """Return measured and fitted stress, what each law leaves, and the upper half as fits to the lower one see it."""
    figure = Figure(figsize=(13.0, 4.0), layout="constrained")
    stress, left, beyond = figure.subplots(1, 3)
    stress.plot(
        curve.stretch[~heldout], curve.stress[~heldout] / 1e3, ".", color="0.65", ms=4, label="measured, fitted"
    )
    stress.plot(curve.stretch[heldout], curve.stress[heldout] / 1e3, "k.", ms=4, label="measured, held out")
    beyond.plot(curve.stretch, curve.stress / 1e3, ".", color="0.65", ms=4)
    for fit, style in zip(fits, STYLES, strict=True):
        name = fit.law.replace("_", "-")
        fitted = nominal_stress(fit.law, fit.parameters, curve.stretch)
        label = f"{name}: held out {fit.heldout_rms_pa / 1e3:.3g} kPa"
        stress.plot(curve.stretch, fitted / 1e3, style, label=label)
        left.plot(curve.stretch, (fitted - curve.stress) / 1e3, style, label=name)
        lower, middle = fit_lower_half(fit.law, curve)
        label = f"{name}: above {fit.extrapolation_rms_pa / 1e3:.3g} kPa"
        beyond.plot(curve.stretch, nominal_stress(fit.law, lower, curve.stretch) / 1e3, style, label=label)
    left.axhline(0.0, color="k", lw=0.5)
    beyond.axvline(middle, color="k", lw=0.5)
    stress.set(xlabel="stretch [-]", ylabel="nominal stress [kPa]", title="uniaxial tension")
    left.set(xlabel="stretch [-]", ylabel="fitted - measured [kPa]", title="what each law leaves")
    beyond.set(xlabel="stretch [-]", title="fitted left of the line only", ylim=(0.0, 1.4e-3 * curve.stress.max()))
    for ax in (stress, left, beyond):
        ax.legend(fontsize=8)
    return figure


def draw_pressure_map(
    pressure_real: np.ndarray, pressure_sim: np.ndarray, mapped: np.ndarray, spread: np.ndarray, heldout: np.ndarray
) -> Figure:
    """Return, per chamber, the correction over P_R and the error of held-out holds; arguments (holds, n) Pa."""
    chambers = pressure_real.shape[1]
    figure = Figure(figsize=(3.2 * chambers + 0.6, 5.6), layout="constrained")
    for i, (top, bottom) in enumerate(figure.subplots(2, chambers, squeeze=False).T):
        x = pressure_real[:, i] / 1e3
        top.plot(
            x[~heldout], (pressure_sim - pressure_real)[~heldout, i] / 1e3, ".", color="0.7", label="training holds"
        )
        top.plot(x[heldout], (pressure_sim - pressure_real)[heldout, i] / 1e3, "ko", ms=4, mfc="none", label="held out")
        top.plot(x[heldout], (mapped - pressure_real)[heldout, i] / 1e3, "r+", ms=6, label="f_RS")
        error = (mapped - pressure_sim)[heldout, i] / 1e3
        bottom.errorbar(
            x[heldout], error, spread[heldout, i] / 1e3, fmt="r.", lw=0.8, label="error, bar: spread of members"
        )
        bottom.axhline(0.0, color="k", lw=0.5)
        top.set(title=f"chamber {i + 1}", xlabel="P_R [kPa]")
        bottom.set(xlabel="P_R [kPa]")
        if i == 0:
            top.set_ylabel("P_S - P_R [kPa]")
            bottom.set_ylabel("f_RS - P_S, held out [kPa]")
            top.legend(fontsize=8)
            bottom.legend(fontsize=8)
    return figure
