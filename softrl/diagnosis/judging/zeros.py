"""Gauges whose zero is off, or wanders from run to run: it is taken out of every run by itself, and has to be told."""

import numpy as np

from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.parts import bias, supplied

LEAST_SHARE = 0.01  # of the largest pressure: zeros that lie less far apart, or off, are no news


def told_of_zeros(valve: Finding) -> list[str]:
    """Return a sentence for each gauge that reads an amount beside what the valve supplies, in all runs or another in each."""
    if valve.unknown:
        return []
    runs = {run.name: run for run in (*valve.part.problem.runs, *valve.judge.problem.runs)}
    made = supplied(list(runs.values()), valve)
    zeros = np.stack([bias(run.pressure_meas - to.pressure_meas) for run, to in zip(runs.values(), made, strict=True)])
    least = LEAST_SHARE * valve.part.problem.robot.largest_pa
    return [told for c, mine in enumerate(1e-3 * zeros.T) if (told := _told(f"The gauge of chamber {c + 1}", mine, 1e-3 * least))]


def _told(gauge: str, zeros_kpa: np.ndarray, least_kpa: float) -> str:
    low, high, mean = zeros_kpa.min(), zeros_kpa.max(), zeros_kpa.mean()
    if high - low > least_kpa:
        return (
            f"{gauge} reads {low:.2g} to {high:.2g} kPa beside what the valve supplies, another amount in every run: its zero "
            "wanders. It was taken out run by run; where the gauge is used elsewhere it goes along."
        )
    if abs(mean) > least_kpa:
        return (
            f"{gauge} reads {abs(mean):.2g} kPa {'more' if mean > 0.0 else 'less'} than the valve supplies, in every run: it was "
            "taken out as the gauge's zero; where the gauge is used elsewhere it goes along."
        )
    return ""
