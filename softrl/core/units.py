"""Conversion between the units in file columns or config keys and the SI values used inside."""

import numpy as np

from softrl.core.errors import RecordingError

# unit suffix -> (SI unit, factor); a column or key ends in `_<suffix>`
FACTORS: dict[str, tuple[str, float]] = {
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "pa": ("Pa", 1.0),
    "kpa": ("Pa", 1e3),
    "psi": ("Pa", 6894.757293168),
    "bar": ("Pa", 1e5),
    "mbar": ("Pa", 1e2),
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "rad": ("rad", 1.0),
    "deg": ("rad", np.pi / 180.0),
    "n": ("N", 1.0),
    "mn": ("N", 1e-3),
    "kg": ("kg", 1.0),
    "g": ("kg", 1e-3),
}


def si_factor(column: str) -> float:
    """Return the factor that turns the unit named by a column's suffix into SI.

    Raises
    ------
    RecordingError
        If the name ends in no known unit.
    """
    suffix = column.rsplit("_", 1)[-1]
    if suffix not in FACTORS:
        raise RecordingError(f"column '{column}' ends in no known unit; expected a suffix out of {', '.join(FACTORS)}")
    return FACTORS[suffix][1]
