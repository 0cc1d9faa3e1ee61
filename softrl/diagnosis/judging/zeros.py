"""Gauges whose zero wanders from run to run: it is taken out of every run by itself, and has to be told."""

import numpy as np

from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.parts import bias, supplied

LEAST_SHARE = 0.01  # of the largest pressure: zeros that lie less far apart are no news


def wandering_zeros(valve: Finding) -> list[str]:
    """Return a sentence for each gauge that reads another amount beside what the valve supplies from run to run."""
    if valve.unknown:
        return []
    runs = {run.name: run for run in (*valve.part.problem.runs, *valve.judge.problem.runs)}
    made = supplied(list(runs.values()), valve)
    zeros = np.stack([bias(run.pressure_meas - to.pressure_meas) for run, to in zip(runs.values(), made, strict=True)])
    wander = np.ptp(zeros, axis=0) > LEAST_SHARE * valve.part.problem.robot.pressure_max_pa
    return [
        f"The gauge of chamber {c + 1} reads {1e-3 * low:.2g} to {1e-3 * high:.2g} kPa beside what the valve supplies, another "
        "amount in every run: its zero wanders. It was taken out run by run; where the gauge is used elsewhere it goes along."
        for c, (low, high) in enumerate(zip(zeros.min(axis=0), zeros.max(axis=0), strict=True))
        if wander[c]
    ]
