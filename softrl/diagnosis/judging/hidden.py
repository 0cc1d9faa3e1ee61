"""What a calibrated map of pressures hides: physics that it has absorbed, said in words, and the simulator behind it."""

from dataclasses import replace
from typing import Any

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.calibration.pressure_map import PressureMap
from softrl.diagnosis.fitting.problem import Problem

STEPS = 41  # of a sweep of one chamber
BEND_SHARE = 0.03  # of the range: a correction that leaves its line by more bends
OFFSET_SHARE = 0.01
GAIN_CHANGE = 0.03
CROSS_SHARE = 0.02
UNDRIVEN = 1e-3  # of the widest range of any chamber


def behind(problem: Problem, calibration: Calibration) -> Problem:
    """Return the problem whose commands went through the calibrated map, as the simulator is driven in use."""
    mapping = PressureMap(calibration)
    runs = tuple(replace(run, pressure_cmd=mapping.real_to_sim(run.pressure_cmd)) for run in problem.runs)
    return problem.on(runs)


def read_map(calibration: Calibration) -> list[dict[str, Any]]:
    """Return for every chamber what the map does when that chamber alone moves: gain, offset, bend, cross-talk.

    Notes
    -----
    A line ``P_S = gain P_R + offset`` is fitted over the trained range; the bend is the largest departure from it, at
    the pressure where it lies; a ceiling is told by a slope at the upper end of less than half the gain. A chamber that was
    not driven when the map was fitted is left out: the map says nothing of it.
    """
    mapping, found = PressureMap(calibration), []
    widest = float(np.max(calibration.pressure_high - calibration.pressure_low))
    rest = np.clip(0.0, calibration.pressure_low, calibration.pressure_high)
    for chamber in range(calibration.chambers):
        low, high = calibration.pressure_low[chamber], calibration.pressure_high[chamber]
        if not high - low > UNDRIVEN * widest:
            continue
        sweep = np.tile(rest, (STEPS, 1))
        sweep[:, chamber] = np.linspace(low, high, STEPS)
        made = mapping.real_to_sim(sweep)
        gain, offset = np.polyfit(sweep[:, chamber], made[:, chamber], 1)
        away = made[:, chamber] - gain * sweep[:, chamber] - offset
        place = int(np.argmax(np.abs(away)))
        slopes = np.gradient(made[:, chamber], sweep[:, chamber])
        others = np.delete(np.ptp(made, axis=0), chamber) / (high - low)
        found.append(
            {
                "chamber": chamber + 1,
                "gain": float(gain),
                "offset_kpa": 1e-3 * float(offset),
                "bend_kpa": 1e-3 * float(away[place]),
                "bend_at_kpa": 1e-3 * float(sweep[place, chamber]),
                "slope_at_top_share": float(slopes[-3:].mean() / gain) if gain != 0.0 else 1.0,
                "crosstalk_share": float(others.max(initial=0.0)),
                "range_kpa": 1e-3 * float(high - low),
            }
        )
    return found


def in_words(rows: list[dict[str, Any]]) -> list[str]:
    """Return what stands out of a map, one sentence a chamber; chambers where it is nearly the identity are left out."""
    lines = []
    for row in rows:
        parts = []
        if abs(row["gain"] - 1.0) > GAIN_CHANGE:
            parts.append(f"scales the pressure by {row['gain']:.3g}")
        if abs(row["offset_kpa"]) > OFFSET_SHARE * row["range_kpa"]:
            parts.append(f"shifts it by {row['offset_kpa']:.2g} kPa")
        if abs(row["bend_kpa"]) > BEND_SHARE * row["range_kpa"]:
            parts.append(f"bends by {row['bend_kpa']:.2g} kPa near {row['bend_at_kpa']:.3g} kPa")
        if row["slope_at_top_share"] < 0.5:
            parts.append("flattens at its upper end as behind a ceiling of the supply")
        if row["crosstalk_share"] > CROSS_SHARE:
            parts.append(f"moves another chamber by {row['crosstalk_share']:.0%} of its pressure")
        if parts:
            lines.append(f"The calibrated map of chamber {row['chamber']} {', '.join(parts)}.")
    return lines or ["The calibrated map is nearly the identity: it has absorbed nothing that stands out."]
