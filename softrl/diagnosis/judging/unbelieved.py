"""Gauges that do not show what acts on the body: clipped, elsewhere, dead. What is found without them is told in their place."""

from collections.abc import Sequence

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.judging.verdict import FAR_BETTER
from softrl.recordings.check import CLIPPED_SHARE
from softrl.recordings.recording import Recording


def doubtful(diagnosis: Diagnosis, runs: Sequence[Recording]) -> bool:
    """Return whether gauges clip and much is left, or a lag or a black box is far better where nothing is understood."""
    if not diagnosis.data.get("measured_pressure_used"):
        return False
    held = diagnosis.errors_mm["heldout"]
    if clipping(runs):
        return held["corrected"] > FAR_BETTER * held["noise_floor"]
    plain = min(held.get(name, np.inf) for name in ("one_lag", "blackbox"))
    return diagnosis.verdict == "unknown" and _far_better(plain, held["corrected"], held["noise_floor"])


def tells_more(without: Diagnosis, diagnosis: Diagnosis) -> bool:
    """Return whether a diagnosis ``without`` gauges has an answer, far better than what ``diagnosis`` has with them."""
    if without.verdict == "unknown":
        return False
    held, alone = diagnosis.errors_mm["heldout"], without.errors_mm["heldout"]
    return _far_better(alone["corrected"], held["corrected"], held["noise_floor"])


def told_of_unbelieved(without: Diagnosis, diagnosis: Diagnosis, runs: Sequence[Recording]) -> str:
    """Return in a sentence why measured pressures were left out."""
    unit = "deg" if diagnosis.errors_deg else "mm"
    least, most = ((d.errors_deg or d.errors_mm)["heldout"]["corrected"] for d in (without, diagnosis))
    clips: dict[str, list[str]] = {}
    for chamber, level in clipping(runs).items():
        clips.setdefault(f"{1e-3 * level:.3g} kPa", []).append(str(chamber + 1))
    told = ", ".join(f"{level} in chamber {', '.join(chambers)}" for level, chambers in clips.items())
    why = f"they go no higher than {told}" if told else "they clip, sit elsewhere, or are dead"
    return (
        f"Measured pressures were left out, for the motion contradicts them ({why}): with them the correction errs by "
        f"{most:.3g} {unit} from the command on held-out runs, without them by {least:.3g} {unit}."
    )


def clipping(runs: Sequence[Recording]) -> dict[int, float]:
    """Return by chamber the pressure, Pa, at which its gauge stays while commands go above it, where one does."""
    found = {}
    for chamber in range(runs[0].pressure_cmd.shape[1]):
        seen = [run.pressure_meas[:, chamber] for run in runs if run.pressure_meas is not None]
        level = max((float(values.max()) for values in seen), default=np.inf)
        above = [run.pressure_cmd[:, chamber] > level for run in runs]
        share = np.mean(np.concatenate([values == level for values in seen])) if seen else 0.0
        if share > CLIPPED_SHARE and np.any(np.concatenate(above)):
            found[chamber] = level
    return found


def _far_better(error: float, than: float, noise: float) -> bool:
    return than > FAR_BETTER * max(error, noise)
