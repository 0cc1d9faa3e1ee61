"""Findings in plain words: the verdict, what is named, what does as well, what is left, what to record next."""

from collections.abc import Sequence
from math import log
from typing import Any

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.judging.along import BENDS
from softrl.diagnosis.judging.days import told_of_days
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.lateness import lateness
from softrl.diagnosis.judging.leftover import UNEVEN_FACTOR
from softrl.diagnosis.judging.locate import significant
from softrl.diagnosis.judging.verdict import AS_GOOD, alternatives, misleads
from softrl.diagnosis.telling.entries import shown_in
from softrl.diagnosis.telling.parameters import effect_sentence
from softrl.diagnosis.telling.separate import separating_program
from softrl.robots.robot import Robot

PIECE_SHARE = 0.2  # of the wrong bending: a piece of the body with less goes without saying
UNTOLD = "more than white noise; it was not found to be physics"
OWN_FORM = "as much as a lumped body may err for a robot that is no even rod: simulator=rom on its mesh would tell"
RIVALS = 4  # that are told, nearest first; what contests is told always
TOLD = 0.02  # logarithm of a retuned parameter over its nominal value: less goes without saying
BESIDE = {
    "one_lag": "one lag alone",
    "static": "a static map",
    "blackbox": "a black box of equal data",
}
EXPERIMENTS = {
    "valve": "steps and a multisine of one chamber with the chamber's pressure measured",
    "chamber": "each chamber alone to three levels, held 20 s, with the inlet closed for the last 10 s",
    "body": "the same triangle at three rates a decade apart, each amplitude twice, and holds of 60 s",
    "load": "the same holds with the base turned by 90 degrees, and with a known mass at the tip",
    "sensor": "the tip moved by hand to known places without pressure, and a fast multisine",
}


def next_experiment(findings: Sequence[Finding], verdict: str, robot: Robot, noise_m: float) -> dict[str, Any] | None:
    """Return the recording that would help most, or None if nothing is open."""
    if verdict not in ("indistinguishable", "unknown"):
        return None
    open_sites = [r.choice.site for f in findings for r in f.rivals if r.contests]
    open_sites += [r.instead_of.site for f in findings for r in f.rivals if r.contests]
    separates: list[str] = []
    if verdict == "unknown":
        open_sites = _unknown_sites(findings)
    else:
        separates = [n.choice.label() for f in findings for n in f.named if alternatives(f)]
        separates += sorted({name for f in findings for name in alternatives(f)})
    found: dict[str, Any] = {
        "separates": separates,
        "program": "; then ".join(EXPERIMENTS[site] for site in dict.fromkeys(open_sites)),
        **_limits(robot),
    }
    if verdict == "indistinguishable":
        found |= _planned(findings, noise_m) or {}
    return found


def _unknown_sites(findings: Sequence[Finding]) -> list[str]:
    """Return where to look for what no effect explains: without a gauge behind it, the valve is not cleared."""
    if len(findings) > 1:
        return ["valve"] if findings[0].unknown else ["body", "load"]
    gauged = all(run.pressure_meas is not None for run in findings[0].part.problem.runs)
    return ["body", "load"] if gauged else ["valve", "body", "load"]


def _limits(robot: Robot) -> dict[str, float]:
    """Return the lowest and highest command, Pa, or in its own unit where it is no pressure."""
    low, high = robot.pressure_min_pa, robot.pressure_max_pa
    if robot.command == "pressure":
        return {"pressure_min_pa": low, "pressure_max_pa": high}
    return {f"{robot.command}_min": low / robot.command_to_pa, f"{robot.command}_max": high / robot.command_to_pa}


def _planned(findings: Sequence[Finding], noise_m: float) -> dict[str, Any] | None:
    """Return the program that tells the nearest open rival of the body apart, with how far it does.

    What a gauge shows of the valve needs none that is planned: steps tell its laws apart.
    """
    for finding in findings:
        if finding.part.problem.target == "motion":
            for rival in sorted(finding.rivals, key=lambda r: r.gap.value):
                if rival.contests:
                    return separating_program(finding.part.problem, finding.final, rival.trial, noise_m, finding.part.now)
    return None


def sentences(diagnosis: Diagnosis, findings: Sequence[Finding], ends: Sequence[str]) -> list[str]:
    """Return the finding in plain words, the verdict first; ``ends`` are those of the corrected simulator, see ``Model``."""
    lines = [_verdict_sentence(diagnosis) + _but(findings, diagnosis.verdict), _error_sentence(diagnosis)]
    if diagnosis.effects and misleads(findings, diagnosis.errors_mm["heldout"]):
        behind = " What is named holds under the measured pressure; what the command does to it is not understood."
        lines.append(
            "Do not rely on the corrected simulator: from the command it predicts held-out runs worse than retuning or one lag."
            + (behind if len(findings) > 1 else "")
        )
    lines += [effect_sentence(effect, findings[0].part.problem.robot, len(findings) > 1) for effect in diagnosis.effects]
    lines += _ungauged(findings)
    lines += [line for finding in findings for line in finding.switched]
    lines += _rival_sentences(diagnosis.rivals)
    odd = [name for name, entry in diagnosis.retuned.items() if not entry["plausible"]]
    if odd and diagnosis.verdict != "nothing missing":
        lines.append(
            f"Retuning alone drives {', '.join(odd)} to the end of the plausible range: "
            "evidence that physics is missing."
        )
    lines += _at_the_end(diagnosis, ends)
    lines += _along_sentence(diagnosis) + lateness(findings)
    left = [finding for finding in findings if finding.left > finding.judge.material]
    lines += [_left_sentence(finding) + _from_command(diagnosis, finding) for finding in left]
    return lines + told_of_days(findings)


def _rival_sentences(rivals: Sequence[dict[str, Any]]) -> list[str]:
    """Return how the first alternatives do beside what is named, and any other that contests it."""
    return [_rival_sentence(rival) for k, rival in enumerate(rivals) if k < RIVALS or rival["contests"]]


def _rival_sentence(rival: dict[str, Any]) -> str:
    """Return how an alternative does beside what is named."""
    gap, low, high = (rival[name] for name in ("score_gap", "low", "high"))
    if rival["contests"]:
        verb = "cannot be told from"
    elif rival["equivalent"]:
        verb = "is a law that contains, or another form of, what is named, and does no better than"
    elif gap < 0.0:
        verb = "needs more parameters and fits all runs together no better than"
    elif low <= 0.0:
        verb = "is hardly worse held out, but is on all runs together, or needs more parameters, than"
    else:
        verb = "is worse than"
    size, ends = ("smaller", (-high, -low)) if gap < 0.0 else ("larger", (low, high))
    return (
        f"{rival['name']} {verb} {rival['instead_of']}: its held-out error is {size} by {abs(gap):.2g} "
        f"{rival['unit']} ({ends[0]:.2g} to {ends[1]:.2g})."
    )


def _little(finding: Finding) -> list[str]:
    """Return in words that the body itself may leave as much, if it may."""
    judge = finding.judge
    if finding.days:
        factor, unit = shown_in(finding)
        return [f"sessions differ a little in themselves: {factor * finding.days.left:.3g} {unit} where each may"]
    if finding.left <= UNEVEN_FACTOR * judge.material and not finding.reasons:
        return ["a detail of the body may leave as much"]
    return [f"{finding.left / judge.travel:.1%} of the motion, {OWN_FORM}"] if finding.left <= judge.form else []


def _but(findings: Sequence[Finding], verdict: str) -> str:
    """Return what a verdict of nothing missing leaves open, where more stays than a detail of the body would."""
    if verdict != "nothing missing" or all(f.left <= UNEVEN_FACTOR * f.judge.material for f in findings):
        return ""
    if findings[-1].days:
        return " What stays is, for the most part, that sessions differ a little in themselves."
    if all(f.left <= max(f.judge.form, UNEVEN_FACTOR * f.judge.material) for f in findings):
        return f" What stays is {findings[-1].left / findings[-1].judge.travel:.1%} of the motion, {OWN_FORM}."
    return " But more stays than white noise, and no test tells whether it is slow noise of the sensor or something else."


def _ungauged(findings: Sequence[Finding]) -> list[str]:
    """Return that the place of a valve's effect is not certain, where no gauge between valve and body was read."""
    at_valve = any(named.choice.site == "valve" for named in findings[0].named)
    if len(findings) > 1 or not at_valve:
        return []
    return ["No pressure behind the valve was used: what is named at the valve may as well lie between pressure and force."]


def _along_sentence(diagnosis: Diagnosis) -> list[str]:
    """Return where along the body the markers show the mismatch before any effect is added, if they do."""
    rows = [row for row in significant(diagnosis.located) if str(row["region"]).startswith(BENDS)]
    plain = [f"it {row['region']} ({row['effect_size']:.0%})" for row in rows if row["effect_size"] >= PIECE_SHARE]
    told = "Before any effect is added the markers show where the body's bending is wrong (share of what is): "
    return [told + "; ".join(plain) + "."] if plain else []


def _at_the_end(diagnosis: Diagnosis, ends: Sequence[str]) -> list[str]:
    """Return that the data drive the parameters ``ends`` of the correction, too, to an end of their range, if they do."""
    if not (diagnosis.effects and ends):
        return []
    return [
        f"With what is named {', '.join(ends)} still ends at the edge of the plausible range: the simulator's body differs "
        "from the robot's in more than that, so take the parameters above as a description, not as measurements."
    ]


def _from_command(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return what is left from command to motion where parameters refitted so leave less than under the measured pressure."""
    unit = "deg" if diagnosis.errors_deg else "mm"
    held = (diagnosis.errors_deg or diagnosis.errors_mm)["heldout"]
    left = max(held["corrected"] ** 2 - held["noise_floor"] ** 2, 0.0) ** 0.5
    if finding.joint is None or left >= shown_in(finding)[0] * finding.left:
        return ""
    return f" From the command it is {left:.2g} {unit}: the measured pressure is itself sampled, late and noisy."


def _error_sentence(diagnosis: Diagnosis) -> str:
    unit = "deg" if diagnosis.errors_deg else "mm"
    held = (diagnosis.errors_deg or diagnosis.errors_mm)["heldout"]
    beside = ", ".join(f"{words} {held[name]:.3g} {unit}" for name, words in BESIDE.items() if name in held)
    return (
        f"Held-out error from command to motion: nominal {held['nominal']:.3g} {unit}, retuned only "
        f"{held['retuned']:.3g} {unit}, corrected {held['corrected']:.3g} {unit}, noise {held['noise_floor']:.2g} {unit}; "
        f"beside them {beside}."
    )


def _verdict_sentence(diagnosis: Diagnosis) -> str:
    names_ = " and ".join(f"{effect['title']} ({effect['where']})" for effect in diagnosis.effects)
    if diagnosis.verdict == "nothing missing":
        held = diagnosis.errors_mm["heldout"]
        found = {name: entry for name, entry in diagnosis.retuned.items() if abs(log(entry["value"] / entry["nominal"])) > TOLD}
        values = ", ".join(f"{name} {entry['value']:.3g} for {entry['nominal']:.3g}" for name, entry in found.items())
        retuned = f"retuned parameters suffice ({values})" if found else "retuned parameters suffice"
        if held["nominal"] <= AS_GOOD * held["retuned"]:
            retuned = "its own parameters suffice"
        elif any(not entry["plausible"] for entry in found.values()):
            return (
                f"No effect is needed beside retuning, but that goes to the end of what is plausible ({values}): the "
                "robot's data are wrong, or it carries or lacks something that acts like these."
            )
        return f"Nothing is missing from the simulator that these recordings could show: {retuned}."
    if diagnosis.verdict == "named":
        return f"The simulator leaves out: {names_}."
    if diagnosis.verdict == "indistinguishable":
        alike = ", ".join(sorted({row["name"] for row in diagnosis.rivals if row["contests"]}))
        return f"The simulator leaves out {names_}; the recordings cannot tell from it: {alike}."
    also = f" What is named describes part of it and is no identification: {names_}." if names_ else ""
    return f"Something is missing that no effect of the library explains.{also}"


def _left_sentence(finding: Finding) -> str:
    factor, unit = shown_in(finding)
    closest = f"; {finding.closest} came closest without explaining it" if finding.closest else ""
    offer = finding.offer
    more = (
        f" A map without physics, fitted to what is left, would remove {factor * offer.gap.value:.2g} {unit} of it on "
        "held-out runs; it is offered as a correction only, for the range that was recorded."
        if offer.pays
        else ""
    )
    why = f" ({'; '.join([*finding.reasons, *_little(finding)]) or UNTOLD})"
    return f"{finding.part.title}: {factor * finding.left:.3g} {unit} above the noise stay unexplained{why}{closest}.{more}"
