"""Gauges that do not show what acts on the body: clipped, elsewhere, dead. What is found without them is told in their place."""

from collections.abc import Mapping, Sequence

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.judging.parts import BEHIND_GAUGES
from softrl.diagnosis.judging.verdict import FAR_BETTER
from softrl.recordings.check import is_clipping
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

Clips = Mapping[int, float]


def doubtful(diagnosis: Diagnosis, clips: Clips) -> bool:
    """Return whether a gauge ``clips`` and much is left, or a lag or a static map is far better where nothing is understood.

    Gauges are believed where the motion follows them far better than those tell it from commands: it is the valve then that is
    not understood.
    """
    if not diagnosis.data.get("measured_pressure_used"):
        return False
    held = diagnosis.errors_mm["heldout"]
    if clips:
        return held["corrected"] > FAR_BETTER * held["noise_floor"]
    unknown = diagnosis.verdict == "unknown" and not _is_followed(diagnosis)
    return unknown and _far_better(_plain(held), held["corrected"], held["noise_floor"])


def tells_more(without: Diagnosis, diagnosis: Diagnosis) -> bool:
    """Return whether a diagnosis ``without`` gauges has an answer, far better than what ``diagnosis`` has with them."""
    if without.verdict == "unknown":
        return False
    held, alone = diagnosis.errors_mm["heldout"], without.errors_mm["heldout"]
    return _far_better(alone["corrected"], held["corrected"], held["noise_floor"])


def told_of_unbelieved(without: Diagnosis, diagnosis: Diagnosis, clips: Clips) -> str:
    """Return in a sentence why measured pressures were left out."""
    unit = "deg" if diagnosis.errors_deg else "mm"
    least, most = ((d.errors_deg or d.errors_mm)["heldout"]["corrected"] for d in (without, diagnosis))
    levels: dict[str, list[str]] = {}
    for chamber, level in clips.items():
        levels.setdefault(f"{1e-3 * level:.3g} kPa", []).append(str(chamber + 1))
    told = ", ".join(f"{level} in chamber {', '.join(chambers)}" for level, chambers in levels.items())
    why = f"they go no higher than {told}" if told else "they clip, sit elsewhere, or are dead"
    return (
        f"Measured pressures were left out, for the motion contradicts them ({why}): with them the correction errs by "
        f"{most:.3g} {unit} from the command on held-out runs, without them by {least:.3g} {unit}."
    )


def clipping(runs: Sequence[Recording], robot: Robot) -> dict[int, float]:
    """Return by chamber the pressure, Pa, at which its gauge stays while commands go above it, where one does.

    None where commands are no pressures: how high they ask for is not known then.
    """
    found = {}
    for chamber in range(robot.chambers if robot.command == "pressure" else 0):
        seen = [run.pressure_meas[:, chamber] for run in runs if run.pressure_meas is not None]
        level = max((float(values.max()) for values in seen), default=np.inf)
        above = any(bool((run.pressure_cmd[:, chamber] > level).any()) for run in runs)
        if above and is_clipping(np.concatenate(seen) == level):
            found[chamber] = level
    return found


def _is_followed(diagnosis: Diagnosis) -> bool:
    """Return whether behind the gauges far less of the motion is left than a lag or a static map leaves of it from commands."""
    errors, unit = (diagnosis.errors_deg, "deg") if diagnosis.errors_deg else (diagnosis.errors_mm, "mm")
    left = diagnosis.unexplained[BEHIND_GAUGES][f"rms_above_noise_{unit}"]
    return _plain(errors["heldout"]) > FAR_BETTER * float(left)


def _plain(held: Mapping[str, float]) -> float:
    """Return the least error of a static map, or one lag: infinite where neither was asked.

    Not that of a black box, which learns what no physics of ours is, and says nothing of gauges then.
    """
    return min(held.get(name, np.inf) for name in ("one_lag", "static"))


def _far_better(error: float, than: float, noise: float) -> bool:
    return than > FAR_BETTER * max(error, noise)
