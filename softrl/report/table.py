"""The table of results at the end of a command."""

from collections.abc import Mapping, Sequence
from typing import Any

HIDDEN = ("train/", "loss/")
MOST_COLUMNS = 6  # of a sweep's table
# after the whole loop a stage shows these only; its result.json and its page hold all
HEADLINES = {
    "mesh": ("nodes_count", "volume_cm3", "min_dihedral_deg"),
    "fem": ("equilibria", "failed", "seconds_per_equilibrium_s", "tip_range_mm"),
    "pod": (
        "heldout/static_tip_rms_mm", "heldout/baseline_linear_static_tip_rms_mm", "heldout/dynamic_tip_rms_mm",
        "heldout/baseline_linear_dynamic_tip_rms_mm", "rom_steps_per_s",
    ),
    "calibration": (
        "heldout/yeoh_stress_kpa", "heldout/neo_hookean_stress_kpa", "heldout/pressure_map_rms_kpa",
        "heldout/pressure_map_identity_rms_kpa", "heldout/position_hold_mm", "heldout/uncalibrated_position_hold_mm",
    ),
    "dynamics": (
        "heldout/position_onestep_mm", "heldout/arx_position_onestep_mm", "heldout/position_rollout_mm",
        "heldout/arx_position_rollout_mm", "heldout/inverse_pressure_kpa", "heldout/linear_inverse_pressure_kpa",
    ),
    "surrogate": ("heldout/joint_angle_deg", "heldout/tip_error_mm", "heldout/affine_tip_error_mm", "twin_loaded_rate_hz"),
    "rl": (
        "heldout/circle_position_rmse_mm", "heldout/star_position_rmse_mm", "heldout/figure_eight_position_rmse_mm",
        "heldout/rest_circle_position_rmse_mm",
    ),
    "sim2real": (
        "circle_mm", "circle_open_loop_mm", "star_mm", "star_open_loop_mm", "figure_eight_mm",
        "figure_eight_open_loop_mm", "circle_feedforward_mm", "circle_planned_mm", "star_planned_mm",
        "figure_eight_planned_mm", "recovery_s", "recovery_planned_s", "bandwidth_hz", "bandwidth_predicted_hz",
        "inference_hz", "planned_inference_hz",
    ),
}  # fmt: skip


def table(finished: Sequence[Any]) -> str:
    """Return one line a number: stage, metric, value, in the order in which stages ran."""
    lines = ["", f"{'stage':<12} {'result':<48} {'value':>12}"]
    for outcome in finished:
        lines += [f"{outcome.stage:<12} {name:<48} {value:>12.5g}" for name, value in _shown(outcome, len(finished) > 1)]
        word = "seconds_s (reused)" if outcome.reused else "seconds_s"
        lines.append(f"{outcome.stage:<12} {word:<48} {outcome.seconds:>12.1f}")
    if len(finished) > 1:
        lines.append("every number: result.json in each stage's folder, or make ui")
    report = finished[-1].folder / "report.html"
    if report.is_file():
        lines.append(f"report: {report}")
    return "\n".join(lines)


def sweep_table(stage: str, points: Sequence[tuple[str, str, Mapping[str, float]]]) -> str:
    """Return a line a point: what sets it apart, its run, and the stage's main numbers.

    Parameters
    ----------
    points : (overrides separated by blanks, run id, metrics)
    """
    words = [point[0].split() for point in points]
    shared = set.intersection(*map(set, words))
    labels = [" ".join(word for word in own if word not in shared) or "-" for own in words]
    measured = dict.fromkeys(name for *_, metrics in points for name in metrics if not name.startswith(HIDDEN))
    names = [name for name in HEADLINES.get(stage, tuple(measured)) if name in measured][:MOST_COLUMNS]
    width = max(map(len, [*labels, "point"]))
    lines = [f"[{number}] {name}" for number, name in enumerate(names, start=1)]
    lines.append(f"{'point':<{width}}  {'run':<8}" + "".join(f"{f'[{k + 1}]':>12}" for k in range(len(names))))
    for label, (_, run_id, metrics) in zip(labels, points, strict=True):
        cells = "".join(f"{metrics[n]:>12.5g}" if n in metrics else f"{'-':>12}" for n in names)
        lines.append(f"{label:<{width}}  {run_id[:8]}{cells}")
    return "\n".join(lines)


def _shown(outcome: Any, short: bool) -> list[tuple[str, float]]:
    names = [name for name in outcome.metrics if not name.startswith(HIDDEN)]
    headlines = HEADLINES.get(outcome.stage, tuple(names)) if short else tuple(names)
    return [(name, outcome.metrics[name]) for name in headlines if name in outcome.metrics]
