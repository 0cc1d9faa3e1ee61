"""What is concluded: a diagnosis from the findings, or from the reason why nothing can be told."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.checks.data import Data, Refusal
from softrl.diagnosis.checks.reach import of_other_length, taken_length, told_of_length
from softrl.diagnosis.checks.response import step_responses
from softrl.diagnosis.fitting.problem import MOUNT_SHIFT_SHARE, MOUNT_TURN_RAD, Problem
from softrl.diagnosis.judging.another_body import told_of_mass, told_of_taper
from softrl.diagnosis.judging.correct import Model, Traces, errors, in_mm
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.gauges import told_of_gauges
from softrl.diagnosis.judging.verdict import verdict_of
from softrl.diagnosis.judging.zeros import told_of_zeros
from softrl.diagnosis.telling.entries import effect_entries, retuned_entries, rival_entries, unexplained
from softrl.diagnosis.telling.explain import next_experiment, sentences


def conclude(
    data: Data,
    whole: Problem,
    findings: list[Finding],
    models: dict[str, Model],
    judged: dict[str, dict[str, Traces]],
    located: list[dict[str, Any]],
) -> Diagnosis:
    """Return the diagnosis of ``findings``.

    Parameters
    ----------
    data : the recordings
    whole : the problem from command to motion
    findings : of its parts
    models, judged : the competitors, and what they predict: split -> name -> traces
    located : tests of where simulation and measurement part
    """
    robot, angle = whole.robot, whole.robot.output == "bend_angle"
    noise = data.noise / (robot.length_m if angle else 1.0)
    plain = {split: errors(found, noise) for split, found in judged.items()}
    verdict, responses = verdict_of(findings, plain["heldout"]), step_responses(data.training)
    spaces = {name: whole.space(models[name].hypothesis) for name in ("retuned", "corrected")}
    made = Diagnosis(
        robot_name=robot.name,
        simulator_name=type(whole.simulator).__name__,
        verdict=verdict,
        sentences=[],
        effects=effect_entries(findings),
        simulator_parameters=spaces["corrected"].tuned(models["corrected"].point) | taken_length(whole.simulator),
        retuned=retuned_entries(whole, models["retuned"]),
        rivals=rival_entries(findings, robot),
        located=located,
        errors_mm={split: in_mm(values, robot.length_m, angle) for split, values in plain.items()},
        errors_deg={s: {n: float(np.degrees(e)) for n, e in v.items()} for s, v in plain.items()} if angle else {},
        unexplained=unexplained(findings),
        next_experiment=next_experiment(findings, verdict, robot, data.noise),
        data={
            "warnings": [*_warnings(data, whole, models["corrected"]), *_cut_short(findings)],
            "training_runs": [r.name for r in data.training],
            "heldout_runs": [r.name for r in data.heldout],
            "sessions_placed_separately": whole.register or whole.mounted,
            "orientation_used": whole.orientation,
            "measured_pressure_used": len(findings) > 1,
            "step_responses": asdict(responses),
            "interval_pct": round(100.0 * (2.0 * findings[0].judge.thresholds.confidence - 1.0), 6),
            "sessions_differ": [day._asdict() for finding in findings if finding.days for day in finding.days.each],
        },
        late_s={name: space.late(models[name].point) for name, space in spaces.items()},
    )
    read = responses.sentence()
    gauges = told_of_zeros(findings[0]) + told_of_gauges(findings, made.simulator_parameters) if len(findings) > 1 else []
    verdict_first, *others = sentences(made, findings, models["corrected"].ends)
    form = told_of_length(whole.simulator, robot) + told_of_taper(whole.simulator, made.simulator_parameters)
    form += told_of_mass(findings[-1], robot)
    return replace(made, sentences=[verdict_first, *form, *others, *gauges, *([read] if read else [])])


def cannot_tell(refusal: Refusal, robot_name: str, simulator_name: str) -> Diagnosis:
    """Return the diagnosis of data that cannot tell anything."""
    return Diagnosis(
        robot_name=robot_name,
        simulator_name=simulator_name,
        verdict="unknown",
        sentences=[f"Cannot tell: {refusal.reason}."],
        effects=[],
        simulator_parameters={},
        retuned={},
        rivals=[],
        located=[],
        errors_mm={"train": {}, "heldout": {}},
        errors_deg={},
        unexplained={"cannot_tell": refusal.reason},
        next_experiment=None,
        data={"warnings": [*refusal.mended, *refusal.check.warnings]},
    )


def in_short(diagnosis: Diagnosis, minutes: float | None) -> Diagnosis:
    """Return the ``diagnosis`` for which there was no more time to search when it was done, which says so."""
    line = (
        f"the time to search was over (stage.search.minutes={minutes:g}): what had not been asked by then was left, so that "
        "what is named may not be all, and what is unknown may have a name"
    )
    return replace(diagnosis, data={**diagnosis.data, "warnings": [*diagnosis.data["warnings"], line]})


def _cut_short(findings: list[Finding]) -> list[str]:
    """Return which searches ended after so many steps as they were allowed, one line each."""
    return [
        f"{finding.part.title}: the search ended after {finding.path.most:.2g} steps of the simulator and may not have "
        "asked everything; stage.search.steps, or steps_lumped of simulator=pcc, allows more"
        for finding in findings
        if finding.path.cut_short
    ]


def _warnings(data: Data, whole: Problem, model: Model) -> list[str]:
    """Return what is odd about the recordings, one line each."""
    lines = [*data.check.warnings, *data.mended]
    if whole.register:
        lines.append(
            "the recorded frame differs from the robot's base frame, or between sessions: every session is placed by "
            "the rigid motion that fits best, so that a tilt or an offset of the frame cannot be told"
        )
    elif whole.mounted:
        lines.append(
            f"sessions are mounted a little otherwise each: every one is placed by itself, within "
            f"{np.degrees(MOUNT_TURN_RAD):.0f} deg and {MOUNT_SHIFT_SHARE:.0%} of the length ({_mounts(data, whole, model)})"
        )
    elif length := of_other_length(data.training, whole.robot, whole.simulator, model.hypothesis.effects):
        lines.append(length)
    return lines


def _mounts(data: Data, whole: Problem, model: Model) -> str:
    """Return in words how far each session is turned and moved where ``model`` places it."""
    placed = whole.on(data.used).residual(model.hypothesis, model.point, model.placed).registrations
    return "; ".join(
        f"{session} {np.degrees(np.arccos(min(1.0, 0.5 * (np.trace(turn) - 1.0)))):.2g} deg, {1e3 * np.linalg.norm(shift):.2g} mm"
        + (f", {whole.stiffer[session]:+.1%} in stiffness" if session in whole.stiffer else "")
        for session, (turn, shift) in placed.items()
    )
