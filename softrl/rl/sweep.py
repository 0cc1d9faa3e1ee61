"""The figure of a sweep over alpha: position against force."""

from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softrl.core.sweep import Point, spread_by

POSITION, FORCE = "position_rmse_mm", "force_rmse_n"
NOTHING = 0.05  # share of the reward's scale below which a difference is none


class Trade(NamedTuple):
    """Errors by ``alpha`` (k,), rising: means over seeds in mm and N and their standard deviations, (k,) each."""

    alpha: np.ndarray
    position: np.ndarray
    position_spread: np.ndarray
    force: np.ndarray
    force_spread: np.ndarray


def draw(points: list[Point]) -> dict[str, Figure]:
    """Return the force error over the position error, a point for each alpha, and whether one is traded for the other."""
    curves = sorted({name.split("/")[1].removesuffix(f"_{FORCE}") for point in points for name in point.metrics
                     if name.startswith("heldout/") and name.endswith(f"_{FORCE}")})  # fmt: skip
    trades = {curve: trade(points, curve) for curve in curves if not curve.startswith(("expert_", "rest_"))}
    trades = {curve: found for curve, found in trades.items() if len(found.alpha) > 1}
    if not trades:
        return {}
    figure = Figure(figsize=(4.4 * len(trades) + 0.5, 4.2), layout="constrained")
    for axis, (curve, found) in zip(figure.subplots(1, len(trades), squeeze=False)[0], trades.items(), strict=True):
        _draw_trade(axis, found, trade(points, f"expert_{curve}"))
        axis.set_title(f"{curve.replace('_', ' ')}\n{verdict(found, scales_of(points))}", fontsize=9)
    figure.axes[0].legend(fontsize=8)
    figure.suptitle("policy on held-out curves: mean and s.d. over seeds; hollow: another alpha is better in both", fontsize=9)
    return {"alpha": figure}


def trade(points: list[Point], curve: str) -> Trade:
    """Return the errors on a held-out curve by alpha."""
    position, force = (spread_by(points, "alpha", f"heldout/{curve}_{name}") for name in (POSITION, FORCE))
    rows = [(float(a), *position[a], *force[a]) for a in sorted(position.keys() & force.keys(), key=float)]
    return Trade(*np.array(rows).reshape(-1, 5).T)


def scales_of(points: list[Point]) -> tuple[float, float]:
    """Return the errors in mm and N on whose scale the reward falls, 0 where the points do not say."""
    said = points[0].params
    return 1e3 * float(said.get("task.position_scale_m", 0.0)), float(said.get("task.force_scale_n", 0.0))


def verdict(found: Trade, scales: tuple[float, float]) -> str:
    """Return in words whether alpha trades one error for the other.

    Notes
    -----
    It does not where one alpha is best in both, or where the front is, in one of the two errors, no longer than the seeds
    spread to both sides, or than what the reward hardly feels.
    """
    front = pareto_front(found.position, found.force)
    if len(front) == 1:
        return f"no trade-off: alpha {found.alpha[front[0]]:g} is best in both"
    parts = ((found.position, found.position_spread, scales[0]), (found.force, found.force_spread, scales[1]))
    for error, spread, scale in parts:
        if np.ptp(error[front]) <= max(2.0 * float(spread[front].mean()), NOTHING * scale):
            return "no trade-off: one point, within its spread"
    return f"a trade-off: {len(front)} of {len(found.alpha)} alphas on the front"


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the indices of the points than which none is better in both, by rising ``first``."""
    order = np.lexsort((second, first))
    best = np.minimum.accumulate(second[order])
    return order[np.concatenate([[True], second[order][1:] < best[:-1]])]


def _draw_trade(axis: Axes, found: Trade, expert: Trade) -> None:
    front = pareto_front(found.position, found.force)
    axis.plot(found.position[front], found.force[front], "--", color="0.6", lw=1.0, label="Pareto front of the means")
    if len(expert.alpha):
        axis.plot(expert.position, expert.force, "D", mfc="none", mec="0.5", ms=9, label="model-based expert")
    colors = colormaps["viridis"](np.linspace(0.0, 0.9, len(found.alpha)))
    for i, (a, color) in enumerate(zip(found.alpha, colors, strict=True)):
        axis.errorbar(found.position[i], found.force[i], found.force_spread[i], found.position_spread[i], fmt="o", lw=1.0,
                      color=color, mfc=color if i in front else "none", ms=6, capsize=3, label=f"alpha {a:g}")  # fmt: skip
    axis.set(xlabel="rms position error [mm]", ylabel="rms force error [N]")
    axis.margins(0.15)
