"""Where simulation and measurement part: tests by site, channel, chamber, region, direction, time and band."""

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from softrl.diagnosis.problem import Problem, Residual
from softrl.diagnosis.statistics import block_sums, blocks_of, holm, slope_test, whiteness

BANDS_HZ = ((0.0, 0.1), (0.1, 1.0), (1.0, np.inf))
WHITENESS_LAGS = 20


class Finding(NamedTuple):
    """One test: where it looked, how large the effect is, and the chance of it without any mismatch.

    ``effect_size`` is a correlation (0..1) or a share of the residual's power (0..1); ``channel`` may be a band.
    """

    site: str
    channel: str | None
    chamber: int | None
    region: str | None
    effect_size: float
    p_value: float


def locate(problem: Problem, residual: Residual, floor: float, site: str, block_s: float) -> list[Finding]:
    """Return the tests of one residual, uncorrected: see ``corrected``.

    Parameters
    ----------
    problem : whose runs gave the residual
    residual : measured less simulated
    floor : rms that noise alone leaves in a bin
    site : which part of the pipeline it spans
    block_s : samples farther apart than this count as independent
    """
    drives = [_drive(problem, k) for k in range(len(problem.runs))]
    pressure, rate = (np.concatenate([drive[i] for drive in drives]) for i in (0, 1))
    time = np.concatenate([drive[2] for drive in drives])
    values = np.concatenate(residual.runs)
    blocks = blocks_of(problem.run_of_bin, max(round(block_s / problem.numerics.bin_s), 1))
    strength = np.sqrt(np.sum(values**2, axis=1))
    main = _main_component(values)
    found = [Finding(site, None, None, None, *_above_floor(values, floor, blocks))]
    found += _channels(problem, values, site)
    for chamber in range(problem.robot.chambers):
        p, dp = pressure[:, chamber], rate[:, chamber]
        if np.ptp(p) <= 0.0:
            continue
        found.append(Finding(site, None, chamber + 1, "in step with pressure", *_sized(main, p, blocks)))
        found.append(Finding(site, None, chamber + 1, "loading against unloading", *_sized(main, np.sign(dp), blocks)))
        found.append(Finding(site, None, chamber + 1, "stronger at high pressure", *_sized(strength, p, blocks)))
    total = np.abs(rate).sum(axis=1)
    found.append(Finding(site, None, None, "while pressure changes", *_sized(strength, total, blocks)))
    found.append(Finding(site, None, None, "grows with time", *_sized(strength, time, blocks)))
    return found + _bands(problem, residual, site)


def corrected(findings: list[Finding]) -> list[dict[str, Any]]:
    """Return the findings as plain values, p-values corrected for their number after Holm, strongest first."""
    adjusted: Any = holm([finding.p_value for finding in findings]) if findings else []
    rows = [
        finding._replace(p_value=float(p), effect_size=float(finding.effect_size))._asdict()
        for finding, p in zip(findings, adjusted, strict=True)
    ]
    return sorted(rows, key=lambda row: (row["p_value"] > 0.01, -row["effect_size"]))


def channel_names(problem: Problem) -> list[str]:
    """Return the names of the residual's channels."""
    if problem.target == "pressure":
        return [f"p{i + 1}" for i in range(problem.robot.chambers)]
    if problem.robot.output == "bend_angle":
        return ["bend_angle"]
    names = ["tip_x", "tip_y", "tip_z"]
    return names + (["turn_x", "turn_y", "turn_z"] if problem.orientation else [])


def _sized(target: np.ndarray, regressor: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    size, p_value = slope_test(target, regressor, blocks)
    return abs(size), p_value


def _above_floor(values: np.ndarray, floor: float, blocks: np.ndarray) -> tuple[float, float]:
    """Return (share of power above the floor, p-value), from the spread of the power over blocks."""
    power = np.sum(values**2, axis=1)
    share = 1.0 - floor**2 / max(float(power.mean()), 1e-300)
    means = block_sums(power, blocks) / np.bincount(blocks)
    spread = float(means.std(ddof=1)) / np.sqrt(len(means)) if len(means) > 1 else 0.0
    if share <= 0.0 or spread == 0.0:
        return max(share, 0.0), 1.0
    return share, float(stats.t.sf((means.mean() - floor**2) / spread, len(means) - 1))


def _channels(problem: Problem, values: np.ndarray, site: str) -> list[Finding]:
    """Return each channel's share of the power, with a test against white noise."""
    total = max(float(np.mean(np.sum(values**2, axis=1))), 1e-300)
    found = []
    for name, column in zip(channel_names(problem), values.T, strict=True):
        p_values: list[float] = [
            whiteness(column[problem.run_of_bin == run], WHITENESS_LAGS)[1] for run in range(len(problem.runs))
        ]
        p_value = min(1.0, len(p_values) * min(p_values))
        found.append(Finding(site, name, None, None, float(np.mean(column**2)) / total, p_value))
    return found


def _bands(problem: Problem, residual: Residual, site: str) -> list[Finding]:
    """Return the share of the residual's power in each band; p-value against the share of white noise."""
    found = []
    period = problem.numerics.bin_s
    for low, high in BANDS_HZ:
        shares, expected = [], []
        for run in residual.runs:
            power = (np.abs(np.fft.rfft(run - run.mean(axis=0), axis=0)) ** 2).sum(axis=1)[1:]
            frequency = np.fft.rfftfreq(len(run), period)[1:]
            inside = (frequency >= low) & (frequency < high)
            if inside.any() and not inside.all() and power.sum() > 0.0:
                shares.append(float(power[inside].sum() / power.sum()))
                expected.append((int(inside.sum()), int((~inside).sum())))
        if not shares:
            continue
        count = sum(a for a, _ in expected), sum(b for _, b in expected)
        share = float(np.mean(shares))
        p_value = float(stats.beta.sf(share, count[0], count[1]))
        name = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"above {low:g} Hz"
        found.append(Finding(site, name, None, "band", share, p_value))
    return found


def _main_component(values: np.ndarray) -> np.ndarray:
    """Return the residual (bins,) along the direction in which it is largest."""
    centred = values - values.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred.T @ centred)[0][:, 0])


def _drive(problem: Problem, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pressure (bins, chambers), its rate, and time (bins,) of run ``k``."""
    run = problem.runs[k]
    acting = run.pressure_meas if problem.drive == "measured" and run.pressure_meas is not None else run.pressure_cmd
    pressure = problem.binned(k, acting)
    return pressure, np.gradient(pressure, axis=0), problem.binned(k, run.time[:, None])[:, 0] - run.time[0]
