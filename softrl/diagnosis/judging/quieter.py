"""Noise that was told too loud: where rows are slower than the motion, neighbouring ones differ by what moves, too."""

from dataclasses import replace

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.checks.data import Data

LESS = 0.8  # of the noise: what errs by less on held-out runs shows that the noise is less
SUPPOSED = 0.25  # of the noise, where that may be less
MODELS = {"corrected": "the correction", "retuned": "the retuned simulator", "one_lag": "one lag alone",
          "static": "a static map", "blackbox": "a black box"}  # fmt: skip


def quieter(data: Data, diagnosis: Diagnosis) -> Data | None:
    """Return ``data`` with the noise that the best model of ``diagnosis`` leaves on held-out runs, if that is plainly less.

    No model errs by less than the noise on runs that it has not seen.
    """
    held, told_mm = diagnosis.errors_mm["heldout"], 1e3 * data.noise
    errors = {name: held[name] for name in MODELS if name in held}
    best = min(errors, key=lambda name: errors[name], default=None)
    if best is None or errors[best] >= LESS * told_mm:
        return None
    shown, unit = (diagnosis.errors_deg["heldout"], "deg") if diagnosis.errors_deg else (held, "mm")
    factor = max(shown.values()) / (max(held.values()) or 1.0)
    told = (
        f"noise was told as {factor * told_mm:.3g} {unit}, more than the {factor * errors[best]:.3g} {unit} by which "
        f"{MODELS[best]} errs on held-out runs: that was motion in part, which slow rows do not tell from noise, and all is "
        "examined again with less"
    )
    noise = max(1e-3 * errors[best], data.rounding)
    at_most = data.at_most and best != "corrected"
    return replace(data, noise=noise, at_most=at_most, mended=(*data.mended, told)) if noise < data.noise else None


def supposed(data: Data) -> Data:
    """Return ``data`` with less noise than it tells, to see whether a model is found that errs by less."""
    return replace(data, noise=max(SUPPOSED * data.noise, data.rounding))
