"""Recordings of an arm that shares no code with softrl: one bending arc, a second-order filter for its body, own physics.

Written as others write theirs: CSV files, 25 Hz with jitter, sent off from rest by the first command, each row's command
acting from that row on.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

DT, LENGTH_S, PERIOD_S, RUNS = 0.001, 40.0, 0.04, 6
LENGTH_M, FULL_PA = 0.1845, 250e3
ANGLE = np.deg2rad([-127.0, 113.0, -7.0])
TIME = DT * np.arange(int(LENGTH_S / DT))
Physics = Callable[[np.ndarray], np.ndarray]


def first_order(values: np.ndarray, tau_s: float) -> np.ndarray:
    keep = np.exp(-DT / tau_s)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=0))


def second_order(values: np.ndarray, hertz: float, damping: float) -> np.ndarray:
    w = 2.0 * np.pi * hertz
    a = [1.0, -2.0 + 2.0 * damping * w * DT, 1.0 - 2.0 * damping * w * DT + (w * DT) ** 2]
    return np.asarray(lfilter([(w * DT) ** 2], a, values, axis=0))


def plays(values: np.ndarray, widths: tuple[float, ...]) -> np.ndarray:
    """Return the mean of Prandtl's play operators, each ``width`` wide."""
    found = np.empty((len(widths), *values.shape))
    for out, width in zip(found, widths, strict=True):
        state = np.zeros(values.shape[1])
        for k, value in enumerate(values):
            state = np.clip(state, value - width, value + width)
            out[k] = state
    return np.asarray(found.mean(axis=0))


def rate_limited(values: np.ndarray, pa_per_s: float) -> np.ndarray:
    state, found = np.zeros(values.shape[1]), np.empty_like(values)
    for k, value in enumerate(values):
        state = state + np.clip(value - state, -pa_per_s * DT, pa_per_s * DT)
        found[k] = state
    return found


def throttled(values: np.ndarray, conductance: float, critical: float = 0.4) -> np.ndarray:
    """Return what stands behind a throttle, by compressible flow in absolute pressures (1 atm outside)."""
    state, found = np.full(values.shape[1], 1.013e5), np.empty_like(values)
    for k, value in enumerate(values + 1.013e5):
        upstream, downstream = np.maximum(value, state), np.minimum(value, state)
        beyond = np.clip((downstream / upstream - critical) / (1.0 - critical), 0.0, 1.0)
        step = conductance * upstream * np.sqrt(1.0 - beyond**2) * DT
        state = state + np.sign(value - state) * np.minimum(step, np.abs(value - state))
        found[k] = state - 1.013e5
    return found


def late(values: np.ndarray, by_s: float) -> np.ndarray:
    steps = round(by_s / DT)
    return np.vstack([np.zeros((steps, values.shape[1])), values[:-steps]])


def program(number: int, rng: np.random.Generator) -> np.ndarray:
    """Return steps, sums of sines, or triangles (steps, 3) Pa."""
    if number % 3 == 0:
        hold = rng.choice([1.0, 2.0, 3.0])
        return rng.uniform(0.0, 0.7 * FULL_PA, (int(LENGTH_S / hold) + 2, 3)).repeat(int(hold / DT), axis=0)[
            : len(TIME)
        ]
    if number % 3 == 1:
        f, phase = rng.uniform(0.03, 0.6, (4, 3)), rng.uniform(0.0, 6.28, (4, 3))
        waves = sum(np.sin(2.0 * np.pi * f[i] * TIME[:, None] + phase[i]) for i in range(4))
        return np.asarray(FULL_PA * np.clip(0.35 + 0.09 * waves, 0.0, 0.8))
    period = rng.choice([4.0, 8.0, 12.0])
    return np.asarray(0.7 * FULL_PA * np.abs((TIME[:, None] / period + rng.uniform(0.0, 1.0, 3)) % 1.0 * 2.0 - 1.0))


def tip(pressure: np.ndarray) -> np.ndarray:
    """Return tip positions (steps, 3) m of an arc that bends away from, and grows with, the pressures (steps, 3) Pa."""
    share = pressure / FULL_PA
    shape = [-0.52 * share @ np.cos(ANGLE), -0.52 * share @ np.sin(ANGLE), 0.028 * share.sum(axis=1)]
    x, y, longer = second_order(np.stack(shape, axis=1), 9.0, 0.9).T
    angle = np.hypot(x, y) + 1e-12
    reach = LENGTH_M * (1.0 + longer) / angle
    return np.stack(
        [reach * (1.0 - np.cos(angle)) * x / angle, reach * (1.0 - np.cos(angle)) * y / angle, reach * np.sin(angle)], 1
    )


def write(folder: Path, seed: int, act: Physics | None = None, see: Physics | None = None, day: float = 1.0) -> Path:
    """Write two sessions of three runs; ``act`` lies before the body, ``see`` behind it, ``day`` scales the last session."""
    rng, names = np.random.default_rng(seed), []
    for number in range(RUNS):
        command = program(number, rng)
        acting = command if act is None else act(command)
        position = tip(acting * (day if number >= RUNS // 2 else 1.0))
        position = position if see is None else see(position)
        stamps = np.arange(0.0, LENGTH_S, PERIOD_S)
        stamps = stamps + rng.uniform(-0.1, 0.1, len(stamps)) * PERIOD_S
        rows = np.unique(np.clip(np.round(stamps / DT).astype(int), 0, len(TIME) - 1))
        noisy = position[rows] + 2.5e-4 * rng.standard_normal((len(rows), 3))
        table = np.hstack([TIME[rows, None], 1e-3 * command[rows], 1e3 * noisy])
        header = "time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa,tip_x_mm,tip_y_mm,tip_z_mm"
        names.append(f"rec{number}")
        np.savetxt(folder / f"{names[-1]}.csv", table, "%.6g", ",", header=header, comments="")
    days: dict[str, Any] = {"day0": names[: RUNS // 2], "day1": names[RUNS // 2 :]}
    lines = [f"  {name}: [{', '.join(runs)}]" for name, runs in days.items()]
    (folder / "dataset.yaml").write_text("\n".join(["robot: three_chamber_segment", "sessions:", *lines, ""]))
    return folder
