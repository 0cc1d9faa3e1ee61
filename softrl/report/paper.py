"""The paper's rows beside ours: what `make paper` writes as ``paper.json``."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

ENOUGH_SEEDS = 5
FULL_SIZE = "paper"  # the profile that the rows are meant for


class Row(NamedTuple):
    """One row of [Hong 2025]'s tables.

    Attributes
    ----------
    table, row, unit : which number, and of what
    paper : the paper's value, or None where it states none
    goal : ours to reach, or None
    run : the run that measures it: a stage, or ``rl:<task>``
    metric : the name it has there
    missing : why it is not measured, where it is not
    share : the metric that says whether there was such a number;  lacks : in words, of a seed without one
    """

    table: str
    row: str
    unit: str
    paper: float | None
    goal: float | None
    run: str
    metric: str
    missing: str = ""
    share: str = ""
    lacks: str = "reports no such number"


ROWS = (
    Row("1", "f_RS, pressure", "kPa", 0.13, 0.05, "calibration", "heldout/pressure_map_rms_kpa"),
    Row("1", "f_RS, pressure, identity for comparison", "kPa", None, None, "calibration",
        "heldout/pressure_map_identity_rms_kpa"),
    Row("1", "f_RS, spread of visits to one pressure, which no static map can tell", "kPa", None, None, "calibration",
        "revisited_pressure_rms_kpa"),
    Row("1", "calibration, arc length", "mm", 0.30, 0.15, "calibration", "heldout/arc_length_hold_mm"),
    Row("1", "calibration, orientation", "deg", 0.35, 0.175, "calibration", "heldout/orientation_hold_deg"),
    Row("1", "calibration, curvature", "1/m", None, None, "calibration", "heldout/curvature_hold_per_m"),
    Row("1", "calibration, position", "mm", 1.40, 0.70, "calibration", "heldout/position_hold_mm"),
    Row("1", "calibration, velocity", "mm/s", 12.69, 6.35, "calibration", "heldout/velocity_run_mm_s"),
    *(Row("1", f"{name}, after the diagnosis", unit, paper, goal, "calibration:corrected", metric)
      for name, unit, paper, goal, metric in (
        ("f_RS, pressure", "kPa", 0.13, 0.05, "heldout/pressure_map_rms_kpa"),
        ("calibration, arc length", "mm", 0.30, 0.15, "heldout/arc_length_hold_mm"),
        ("calibration, orientation", "deg", 0.35, 0.175, "heldout/orientation_hold_deg"),
        ("calibration, position", "mm", 1.40, 0.70, "heldout/position_hold_mm"),
        ("calibration, velocity", "mm/s", 12.69, 6.35, "heldout/velocity_run_mm_s"),
      )),
    Row("1", "f_SP, joint angle", "deg", 0.32, 0.05, "surrogate", "heldout/joint_angle_deg"),
    Row("1", "f_SP, position", "mm", 4.23, 0.5, "surrogate", "heldout/tip_error_mm"),
    Row("1", "inverse of f_SP, joint angle", "deg", 0.17, 0.05, "surrogate", "heldout/roundtrip_joint_angle_deg"),
    Row("1", "f_S, position, rollout of 1 s", "mm", 3.35, 1.0, "dynamics", "heldout/position_rollout_mm"),
    Row("1", "f_S, velocity, rollout of 1 s", "mm/s", 14.56, 5.0, "dynamics", "heldout/velocity_rollout_mm_s"),
    Row("1", "f_S, position, one step", "mm", None, None, "dynamics", "heldout/position_onestep_mm"),
    Row("1", "f_S, velocity, one step", "mm/s", None, None, "dynamics", "heldout/velocity_onestep_mm_s"),
    Row("1", "inverse dynamics, pressure", "kPa", 0.38, 0.1, "dynamics", "heldout/inverse_pressure_kpa"),
    Row("2", "simulation, circle", "mm", 1.02, 0.3, "rl:track", "heldout/circle_position_rmse_mm"),
    Row("2", "simulation, star", "mm", 1.24, 0.3, "rl:track", "heldout/star_position_rmse_mm"),
    Row("2", "simulation, force task, position", "mm", 3.20, 0.5, "rl:force", "heldout/force_sine_position_rmse_mm"),
    Row("2", "simulation, force task, force", "N", None, 0.1, "rl:force", "heldout/force_sine_force_error_n"),
    Row("2", "simulation, hybrid task, position", "mm", 1.35, 0.6, "rl:hybrid", "heldout/circle_position_rmse_mm"),
    Row("2", "simulation, hybrid task, force", "N", 0.55, 0.1, "rl:hybrid", "heldout/circle_force_error_n"),
    Row("2", "rig, circle", "mm", 3.38, 0.45, "sim2real", "circle_mm"),
    Row("2", "rig, star", "mm", 6.79, 0.45, "sim2real", "star_mm"),
    Row("2", "rig, force task, position", "mm", 4.68, 0.75, "sim2real:force", "force_sine_mm"),
    Row("2", "rig, hybrid task, position", "mm", 4.20, 0.9, "sim2real:hybrid", "hybrid_circle_mm"),
    Row("2", "rig, hybrid task, force", "N", 0.70, 0.15, "sim2real:hybrid", "hybrid_circle_force_n"),
    *(Row("2", f"rig, {name}, plan{when}", unit, paper, goal, run + task, metric)
      for when, run in (("", "sim2real:"), (" after the diagnosis", "sim2real:corrected_"))
      for name, unit, paper, goal, task, metric in (
        ("force task, position", "mm", 4.68, 0.75, "force", "force_sine_planned_mm"),
        ("hybrid task, position", "mm", 4.20, 0.9, "hybrid", "hybrid_circle_planned_mm"),
        ("hybrid task, force", "N", 0.70, 0.15, "hybrid", "hybrid_circle_planned_force_n"),
      )),
    *(Row(table, f"rig, {name}, {how} after the diagnosis", "mm", paper, 0.45, "sim2real:corrected", metric + ending)
      for table, name, paper, metric in (
        ("2", "circle", 3.38, "circle"), ("2", "star", 6.79, "star"), ("7.4", "unseen 3-D figure-eight", None, "figure_eight"),
      )
      for how, ending in (("policy", "_mm"), ("plan", "_planned_mm"))),
    Row("7.4", "simulation, unseen 3-D figure-eight", "mm", 5.34, 0.3, "rl:track", "heldout/figure_eight_position_rmse_mm"),
    Row("7.4", "rig, unseen 3-D figure-eight", "mm", None, 0.45, "sim2real", "figure_eight_mm"),
    Row("7.4", "recovery after a cut air line", "s", 5.0, 2.0, "sim2real", "recovery_s",
        "the stage sim2real reports no such number in this run", "recovery/recovered_share", "did not recover"),
    Row("7.4", "recovery after a cut air line, after the diagnosis", "s", 5.0, 2.0, "sim2real:corrected", "recovery_s", "",
        "recovery/recovered_share", "did not recover"),
    Row("7.4", "rig, bandwidth at -3 dB", "Hz", None, None, "sim2real", "bandwidth_hz", "", "bandwidth/found_share",
        "has none among the tones"),
    Row("7.4", "policy, inference", "Hz", 300.0, 5000.0, "bench", "policy_hz"),
    Row("7.4", "surrogate in PyBullet, control steps of 20 sub-steps", "Hz", 1000.0, None, "bench",
        "pybullet_control_steps_per_s"),
    Row("7.4", "surrogate, batched environment steps", "Hz", None, 200000.0, "bench", "twin_env_steps_per_s"),
    Row("7.4", "reduced model, steps", "Hz", 5.56, 20000.0, "pod", "rom_steps_per_s"),
)  # fmt: skip


def collect(results: Mapping[str, Sequence[Mapping[str, float]]], why_not: Mapping[str, str],
            commands: Mapping[str, str], profile: str) -> list[dict[str, Any]]:  # fmt: skip
    """Return every row with our mean and spread over seeds; one that was not measured, or not by all seeds, says why.

    Parameters
    ----------
    results : run -> metrics of its finished runs, one a seed
    why_not : run -> why a seed of it failed
    commands : run -> the command that repeats it
    """
    rows = []
    for row in ROWS:
        runs = results.get(row.run, ())
        found = [metrics[row.metric] for metrics in runs if row.metric in metrics]
        tried = len(runs) if found or any(row.share in metrics for metrics in runs) else 0
        whole = found if len(found) == tried else []  # no mean over those that did well
        entry: dict[str, Any] = {
            "table": row.table, "row": row.row, "unit": row.unit, "paper": row.paper,
            "ours_mean": float(np.mean(whole)) if whole else None,
            "ours_std": float(np.std(whole, ddof=1)) if len(whole) > 1 else None,
            "seeds": tried, "goal": row.goal, "command": commands.get(row.run, ""), "profile": profile,
        }  # fmt: skip
        if not tried:
            reason = why_not.get(row.run) or row.missing or f"{row.metric} was not measured by {row.run}"
            entry["reason"] = reason
        else:  # a mean over seeds that were left says so
            missed = f"{tried - len(found)} of {tried} {row.lacks}" if len(found) < tried else ""
            if lacks := [*filter(None, (missed, _shortfall(tried, profile), why_not.get(row.run)))]:
                entry["reason"] = "; ".join(lacks)
        rows.append(entry)
    return rows


def _shortfall(seeds: int, profile: str) -> str:
    """Return what a row lacks to stand beside the paper's; nothing if it is of full size and seeds."""
    lacks = [f"reduced sizes (profile={profile})"] if profile != FULL_SIZE else []
    lacks += [f"{seeds} of {ENOUGH_SEEDS} seeds"] if seeds < ENOUGH_SEEDS else []
    return ", ".join(lacks)


def table_of(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| table | row | paper | ours | seeds | goal | unit | note |", "|---|---|---|---|---|---|---|---|"]
    for row in rows:
        lacking = "no mean" if row["seeds"] else "not measured"
        note = " ".join(row.get("reason", "").split()).replace("|", "\\|")  # an error may have lines and bars of its own
        ours = lacking if row["ours_mean"] is None else f"{row['ours_mean']:.4g}"
        spread = "" if row["ours_std"] is None else f" ± {row['ours_std']:.2g}"
        paper, goal = ("-" if row[key] is None else f"{row[key]:g}" for key in ("paper", "goal"))
        lines.append(
            f"| {row['table']} | {row['row']} | {paper} | {ours}{spread} | {row['seeds']} | {goal} | {row['unit']} "
            f"| {note} |"
        )
    return "\n".join(lines) + "\n"
