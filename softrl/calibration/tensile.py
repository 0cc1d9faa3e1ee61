"""Uniaxial tensile curves from CSV files: plain ``stretch,stress`` files and the semicolon database format."""

import csv
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrl.core.errors import RecordingError

log = logging.getLogger(__name__)
MINIMUM_ROWS = 20
STEADY_SHARE, BACK_SHARE = 0.02, 0.1  # of the range of stretch: jitter of a machine that goes one way; less is no way back
# secant modulus at which a column is surely not in the unit that it should be in
MODULUS_RANGE_PA = (1e3, 1e8)
DATABASE_STRAIN, DATABASE_STRESS = "Engineering Strain", "Engineering Stress (MPa)"


@dataclass(frozen=True)
class TensileCurve:
    """Nominal stress against stretch, increasing in stretch, cut off at the highest stress.

    Attributes
    ----------
    stretch : (samples,) current length / initial length
    stress : (samples,) Pa, force / initial cross-section
    """

    stretch: np.ndarray
    stress: np.ndarray


def read_tensile(path: Path, bins: int, stretch_max: float) -> TensileCurve:
    """Return the curve in ``path`` up to ``stretch_max``.

    It is averaged over ``bins`` equal bins of stretch, so that each stretch weighs the same however densely sampled. Of a file
    that goes out and comes back the way out counts: rubber is softer on the way back.

    Raises
    ------
    RecordingError
        If the file is missing, has not the columns ``stretch, stress`` (kPa) nor those of the database format,
        holds a value that is no finite number, stresses whose unit cannot be the expected one, or no stretch that counts.
    """
    if not path.is_file():
        raise RecordingError(f"tensile curve {path} does not exist; set stage.material_curve to a CSV or to null")
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    if any(DATABASE_STRAIN in line for line in lines[:60]):
        strain, stress = _columns(path, lines, ";", (DATABASE_STRAIN, DATABASE_STRESS))
        stretch, stress = 1.0 + strain, 1e6 * stress
    else:
        stretch, stress = _columns(path, lines, ",", ("stretch", "stress"))
        stress = 1e3 * stress
    out = _way_out(stretch)
    if out < len(stretch):
        log.warning("%s comes back from a stretch of %.3g: the %d rows of the way out count", path, stretch.max(), out)
    return _averaged(path, stretch[:out], stress[:out], bins, stretch_max)


def _way_out(stretch: np.ndarray) -> int:
    """Return how many rows lead to the largest ``stretch`` (rows,), all of them where those after it do not lead back."""
    top, range_ = int(stretch.argmax()), float(np.ptp(stretch))
    out, back = stretch[: top + 1], -stretch[top:]
    steady = all((np.maximum.accumulate(way) - way).max() <= STEADY_SHARE * range_ for way in (out, back))
    return top + 1 if steady and np.ptp(back) > BACK_SHARE * range_ else len(stretch)


def _columns(path: Path, lines: list[str], separator: str, names: tuple[str, str]) -> list[np.ndarray]:
    """Return the two named columns below the first line that holds both names."""
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    header = next((i for i, row in enumerate(rows) if set(names) <= set(row)), None)
    if header is None:
        found = ", ".join(rows[0]) if rows else "nothing"
        raise RecordingError(f"{path} has columns '{found}'; expected '{names[0]}' [-] and '{names[1]}' [kPa]")
    where = [rows[header].index(name) for name in names]
    body = [(i, row) for i, row in enumerate(rows[header + 1 :], header + 2) if any(row)]
    return [np.array([_number(path, i, name, row, k) for i, row in body]) for name, k in zip(names, where, strict=True)]


def _number(path: Path, line: int, name: str, row: list[str], column: int) -> float:
    text = row[column] if column < len(row) else ""
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise RecordingError(f"{path} line {line}: {name}='{text}' is no finite number; mend or remove the row")
    return value


def _averaged(path: Path, stretch: np.ndarray, stress: np.ndarray, bins: int, stretch_max: float) -> TensileCurve:
    if len(stretch) < MINIMUM_ROWS:
        raise RecordingError(f"{path} has {len(stretch)} rows of data; expected at least {MINIMUM_ROWS}")
    if stretch.min() <= 0.0 or stretch.max() < 1.05:
        raise RecordingError(
            f"{path}: stretch runs from {stretch.min():g} to {stretch.max():g}; expected current / initial length, "
            "positive and up to at least 1.05 (a strain must have 1 added)"
        )
    modulus = stress.max() / (stretch[stress.argmax()] - 1.0)
    if not MODULUS_RANGE_PA[0] < modulus < MODULUS_RANGE_PA[1]:
        raise RecordingError(
            f"{path}: stress at the top gives a secant modulus of {modulus / 1e3:.3g} kPa, outside 1..1e5 kPa; "
            "expected nominal stress in kPa (MPa in the database format)"
        )
    # what comes after the highest stress is the rupture
    keep = stretch <= min(stretch[stress.argmax()], stretch_max)
    if not keep.any():
        raise RecordingError(
            f"{path}: stretch begins at {stretch.min():g}, above stage.stretch_max={stretch_max:g}; expected a curve from "
            "about 1 on, or a larger stage.stretch_max"
        )
    order = np.argsort(stretch[keep], kind="stable")
    stretch, stress = stretch[keep][order], stress[keep][order]
    edges = np.linspace(stretch[0], stretch[-1], bins + 1)
    bin_of = np.clip(np.searchsorted(edges, stretch, side="right") - 1, 0, bins - 1)
    count = np.bincount(bin_of, minlength=bins)
    filled = count > 0
    mean = [np.bincount(bin_of, weights=x, minlength=bins)[filled] / count[filled] for x in (stretch, stress)]
    return TensileCurve(*mean)
