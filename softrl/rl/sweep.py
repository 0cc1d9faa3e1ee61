"""The figure of a sweep over alpha: position against force."""

import numpy as np
from matplotlib.figure import Figure

from softrl.core.sweep import Point, spread_by


def draw(points: list[Point]) -> dict[str, Figure]:
    """Return the force error over the position error, a point for each alpha, those on the Pareto front joined."""
    found = []
    curves = sorted({name.split("/")[1].removesuffix("_force_error_n") for point in points for name in point.metrics
                     if name.startswith("heldout/") and name.endswith("_force_error_n")})  # fmt: skip
    for curve in (c for c in curves if not c.startswith(("expert_", "rest_"))):
        position = spread_by(points, "alpha", f"heldout/{curve}_position_rmse_mm")
        force = spread_by(points, "alpha", f"heldout/{curve}_force_error_n")
        if len(force) > 1:
            found.append((curve, np.array([(float(a), *position[a], *force[a]) for a in sorted(force, key=float)])))
    if not found:
        return {}
    figure = Figure(figsize=(4.0 * len(found) + 0.5, 3.8), layout="constrained")
    for axis, (curve, rows) in zip(figure.subplots(1, len(found), squeeze=False)[0], found, strict=True):
        alpha, near, near_spread, firm, firm_spread = rows.T
        axis.errorbar(near, firm, firm_spread, near_spread, fmt="o", color="0.6", ms=5, lw=0.8, capsize=2)
        front = pareto_front(near, firm)
        axis.plot(near[front], firm[front], "o-", color="C0", ms=5, label="Pareto front")
        for a, x, y in zip(alpha, near, firm, strict=True):
            axis.annotate(f"{a:g}", (x, y), xytext=(5, 5), textcoords="offset points", fontsize=8)
        axis.set(xlabel="rms position error [mm]", ylabel="mean force error [N]", title=f"{curve}, numbers: alpha")
        axis.margins(0.12)
        axis.legend(fontsize=8, frameon=False)
    return {"alpha": figure}


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the indices of the points than which none is better in both, by rising ``first``."""
    order = np.lexsort((second, first))
    best = np.minimum.accumulate(second[order])
    return order[np.concatenate([[True], second[order][1:] < best[:-1]])]
