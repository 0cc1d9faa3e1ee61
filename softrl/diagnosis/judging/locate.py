"""Where simulation and measurement part: tests by site, channel, chamber, region, session, direction, history, time and band.

Every test asks whether what is left moves with a regressor, beyond what noise with the same memory would do: only what
follows the drive, its past or the clock is found.
"""

from typing import Any, NamedTuple

import numpy as np

from softrl.diagnosis.fitting.flexible import pressures
from softrl.diagnosis.fitting.problem import Problem, Residual
from softrl.diagnosis.series.statistics import follows, holm

BANDS_HZ = ((0.0, 0.1), (0.1, 1.0), (1.0, np.inf))
SEGMENTS = 8  # pieces of all runs together that the coherence of a band is estimated from, at least
LATE = (1 / 3, 2 / 3)  # shares of a run after which an onset is looked for
HIGH = 0.6  # share of a chamber's largest pressure above which it counts as high
BELOW_MAXIMUM = 0.97  # share of the largest pressure so far under which a chamber is off its maximum
SIGNIFICANT = 0.01
BLOCK_S = 1.0  # samples closer than this may depend on each other even when whitened


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


def locate(problem: Problem, residual: Residual, floor: float, site: str) -> list[Finding]:
    """Return the tests of one residual, uncorrected: see ``corrected``.

    Parameters
    ----------
    problem : whose runs gave the residual
    residual : measured less simulated
    floor : rms that noise alone leaves in a bin
    site : which part of the pipeline it spans
    """
    regressors = _regressors(problem)
    length = max(round(BLOCK_S / problem.numerics.bin_s), 1)
    strength = [np.sum(run**2, axis=1) for run in residual.runs]
    components = _components(residual)
    found = []
    for (chamber, region), runs in regressors.items():
        tests = [follows(target, runs, length) for target in (*components, strength)]
        size, p_value = min(tests, key=lambda test: test[1])
        found.append(Finding(site, None, chamber, region, abs(size), min(1.0, len(tests) * p_value)))
    found += _channels(problem, residual, regressors, site)
    found += _bands(problem, components[0], site)
    power = float(np.mean(np.concatenate(strength)))
    share = max(1.0 - floor**2 / max(power, 1e-300), 0.0)
    alone = min((f.p_value for f in found), default=1.0)
    return [Finding(site, None, None, None, share, min(1.0, len(found) * alone)), *found]


def corrected(findings: list[Finding]) -> list[dict[str, Any]]:
    """Return the findings as plain values, p-values corrected for their number after Holm, strongest first."""
    adjusted: Any = holm([finding.p_value for finding in findings]) if findings else []
    rows = [
        finding._replace(p_value=float(p), effect_size=float(finding.effect_size))._asdict()
        for finding, p in zip(findings, adjusted, strict=True)
    ]
    return sorted(rows, key=lambda row: (row["p_value"] > SIGNIFICANT, -row["effect_size"]))


def channel_names(problem: Problem) -> list[str]:
    """Return the names of the residual's channels."""
    if problem.target == "pressure":
        return [f"p{i + 1}" for i in range(problem.robot.chambers)]
    if problem.robot.output == "bend_angle":
        return ["bend_angle"]
    names = ["tip_x", "tip_y", "tip_z"]
    return names + (["turn_x", "turn_y", "turn_z"] if problem.orientation else [])


def _regressors(problem: Problem) -> dict[tuple[int | None, str], list[np.ndarray]]:
    """Return (chamber from 1, or None; region in words) -> one series (bins,) a run; those that never move are left out."""
    runs = [pressures(problem, k) for k in range(len(problem.runs))]
    most, least = (np.max([(way * run).max(axis=0) for run in runs], axis=0) for way in (1.0, -1.0))
    ways, largest = np.where(most >= least, 1.0, -1.0), np.maximum(most, least)  # a chamber of suction is loaded by less
    sessions = list(dict.fromkeys(run.session for run in problem.runs))
    found: dict[tuple[int | None, str], list[np.ndarray]] = {}
    for i in range(problem.robot.chambers):
        own = [ways[i] * run[:, i] for run in runs]
        top = [np.maximum.accumulate(p) for p in own]
        found[i + 1, "in step with pressure"] = own
        found[i + 1, "above high pressure"] = [np.maximum(p - HIGH * largest[i], 0.0) for p in own]
        found[i + 1, "loading against unloading"] = [_direction(p) for p in own]
        found[i + 1, "below the largest pressure so far"] = [
            (p < BELOW_MAXIMUM * t).astype(float) * p for p, t in zip(own, top, strict=True)
        ]
        found[i + 1, "after a new maximum"] = top
        found[i + 1, "while pressure changes"] = [_change(p) for p in own]
        for name in sessions if len(sessions) > 1 else ():
            found[i + 1, f"in session {name}"] = [
                p * (run.session == name) for p, run in zip(own, problem.runs, strict=True)
            ]
        for j in range(i):
            found[None, f"chambers {j + 1} and {i + 1} together"] = [run[:, i] * run[:, j] for run in runs]
    found |= _with_temperature(problem, runs)
    clocks = [np.linspace(0.0, 1.0, len(run)) for run in runs]
    found[None, "grows with time"] = clocks
    for share in LATE:
        found[None, f"after {share:.0%} of a run"] = [(clock > share).astype(float) for clock in clocks]
    found[None, "while any pressure changes"] = [np.abs(_change(run)).sum(axis=1) for run in runs]
    return {key: series for key, series in found.items() if any(np.ptp(s) > 1e-6 for s in series)}


def _with_temperature(problem: Problem, runs: list[np.ndarray]) -> dict[tuple[int | None, str], list[np.ndarray]]:
    """Return regressors of the temperature, alone and with each chamber's pressure (bins, chambers), where it is recorded."""
    if any(run.temperature is None for run in problem.runs):
        return {}
    warm = [problem.binned(k, np.asarray(run.temperature)[:, None])[:, 0] for k, run in enumerate(problem.runs)]
    middle = float(np.mean(np.concatenate(warm)))
    warmer = [series - middle for series in warm]
    found: dict[tuple[int | None, str], list[np.ndarray]] = {(None, "in step with temperature"): warmer}
    for i in range(problem.robot.chambers):
        found[i + 1, "in step with pressure, the more the warmer"] = [
            run[:, i] * series for run, series in zip(runs, warmer, strict=True)
        ]
    return found


def _change(pressure: np.ndarray) -> np.ndarray:
    """Return how ``pressure`` (bins, ...) changes from bin to bin; of one bin alone nothing is known."""
    return np.asarray(np.gradient(pressure, axis=0)) if len(pressure) > 1 else np.zeros_like(pressure)


def _direction(pressure: np.ndarray) -> np.ndarray:
    """Return +1 on the way up and -1 on the way down, held while the pressure rests."""
    sign = np.sign(np.diff(pressure, prepend=pressure[:1]))
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    return np.asarray(sign[last])


def _channels(
    problem: Problem, residual: Residual, regressors: dict[tuple[int | None, str], list[np.ndarray]], site: str
) -> list[Finding]:
    """Return each channel's share of the power, with the strongest test of it against any regressor."""
    length = max(round(BLOCK_S / problem.numerics.bin_s), 1)
    total = max(float(np.mean(residual.squares)), 1e-300)
    found = []
    for k, name in enumerate(channel_names(problem)):
        target = [run[:, k] for run in residual.runs]
        p_values = [follows(target, runs, length)[1] for runs in regressors.values()]
        share = float(np.mean(np.concatenate(target) ** 2)) / total
        found.append(Finding(site, name, None, None, share, min(1.0, len(p_values) * min(p_values, default=1.0))))
    return found


def _bands(problem: Problem, main: list[np.ndarray], site: str) -> list[Finding]:
    """Return the coherence of the residual with the chambers' pressures in each band.

    Notes
    -----
    ``C = |sum X* Y|^2 / (sum |X|^2 sum |Y|^2)`` over L segments without overlap exceeds c by chance with probability
    ``(1 - c)^(L - 1)`` (textbook form, no equation number checked); corrected for frequencies and chambers.
    """
    runs = [pressures(problem, k) for k in range(len(problem.runs))]
    length = min(min(len(run) for run in runs), sum(len(run) for run in runs) // SEGMENTS)
    starts_ = [(k, s) for k, run in enumerate(runs) for s in range(0, len(run) - length + 1, max(length, 1))]
    if length < 16 or len(starts_) < 4:
        return []
    window = np.hanning(length)[:, None]
    frequency = np.fft.rfftfreq(length, problem.spacing_s)[1:]
    cut_x = np.stack([np.fft.rfft(_level(runs[k][s : s + length]) * window, axis=0)[1:] for k, s in starts_])
    cut_y = np.stack([np.fft.rfft(_level(main[k][s : s + length, None]) * window, axis=0)[1:] for k, s in starts_])
    power_x, power_y = np.sum(np.abs(cut_x) ** 2, axis=0), np.sum(np.abs(cut_y) ** 2, axis=0)
    cross = np.abs(np.sum(np.conj(cut_x) * cut_y, axis=0)) ** 2
    coherence = np.divide(cross, power_x * power_y, out=np.zeros_like(cross), where=power_x * power_y > 0.0)
    found, whole = [], max(float(power_y.sum()), 1e-300)  # nothing is left of a robot that the simulator made without noise
    for low, high in BANDS_HZ:
        inside = (frequency >= low) & (frequency < high)
        if not inside.any():
            continue
        largest = float(min(coherence[inside].max(), 1.0 - 1e-12))
        chance = min(1.0, coherence[inside].size * (1.0 - largest) ** (len(starts_) - 1))
        name = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"above {low:g} Hz"
        found.append(Finding(site, name, None, "band", float(power_y[inside].sum()) / whole, chance))
    return found


def _level(values: np.ndarray) -> np.ndarray:
    """Return ``values`` (steps, n) about their line in time."""
    clock = np.linspace(-1.0, 1.0, len(values))[:, None]
    centred = values - values.mean(axis=0)
    return np.asarray(centred - clock * (clock.T @ centred) / float((clock**2).sum()))


def _components(residual: Residual) -> list[list[np.ndarray]]:
    """Return the residual, run by run, along the two directions in which it is largest."""
    values = np.concatenate(residual.runs)
    level = values.mean(axis=0)
    axes = np.linalg.svd((values - level).T @ (values - level))[0]
    return [[(run - level) @ axis for run in residual.runs] for axis in axes.T[:2]]


def significant(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the corrected findings that chance does not explain."""
    return [row for row in rows if row["p_value"] < SIGNIFICANT]
