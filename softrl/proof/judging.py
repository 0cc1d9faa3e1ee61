"""Diagnose one blind case, and measure what the answer is worth on motion that the fit has not seen."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis, late
from softrl.core.errors import SolverError
from softrl.core.progress import quiet
from softrl.diagnosis.series.noise import redrawn
from softrl.diagnosis.stage import Config as DiagnosisConfig
from softrl.diagnosis.stage import diagnose
from softrl.effects.chain import Plant, chain_of
from softrl.effects.library import effect_class
from softrl.effects.replay import replay
from softrl.pcc.simulator import LENGTH, PccSimulator
from softrl.proof import blackbox
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
Answer = dict[str, Any]


def answer(recordings: Path, robot: Robot, nominal: PccSimulator, config: DiagnosisConfig) -> Answer:
    """Return what the diagnosis says of a folder of recordings; a crash is an answer too, and a wrong one."""
    return diagnosed(lambda: read(recordings, robot), robot, nominal, config)


def diagnosed(
    source: Callable[[], RecordingSet], robot: Robot, nominal: PccSimulator, config: DiagnosisConfig
) -> Answer:
    """Return what the diagnosis says of the recordings that ``source`` gives."""
    started = time.perf_counter()
    try:
        with quiet():
            found = plain(diagnose(config, robot, source(), nominal)[0])
    except Exception as error:  # whatever it is, the case counts as a miss and its message is kept
        found = {"verdict": "crashed", "error": f"{type(error).__name__}: {error}"}
    return found | {"seconds": round(time.perf_counter() - started, 2)}


def plain(found: Diagnosis) -> Answer:
    """Return the parts of a diagnosis that are scored."""
    length = {name: value for name, value in found.simulator_parameters.items() if name == LENGTH}  # not retuned, but taken
    return {
        "verdict": "cannot tell" if "cannot_tell" in found.unexplained else found.verdict,
        "effects": [
            {key: e[key] for key in ("name", "site", "chamber", "parameters")}
            | {key: e.get(key, {}) for key in ("pinned", "pinned_intervals")}
            for e in found.effects
        ],
        "rivals": found.rivals,
        "located": found.located[:5],
        "sentences": found.sentences,
        "corrections": found.corrections(),
        "simulator_parameters": found.simulator_parameters,
        "retuned": {name: entry["value"] for name, entry in found.retuned.items()} | length,
        "retuned_late_s": found.late_s.get("retuned", 0.0),
        "training_runs": found.data.get("training_runs", []),
        "heldout_runs": found.data.get("heldout_runs", []),
    }


def worth(folder: Path, name: str, given: Answer, robot: Robot, nominal: PccSimulator, dt_s: float) -> dict[str, Any]:
    """Return the rms error, mm, of every competitor on held-out runs and on the session out of distribution.

    A model that diverges is left out, which the scores count as closing no gap. The oracle knows the truth without
    noise: its error is the noise. Simulators step by ``dt_s``, as in the fit.
    """
    if given["verdict"] == "crashed":
        return {"heldout": {}, "outside": {}}
    runs = {run.name: run for run in read(folder / "recordings" / name, robot).recordings}
    last = read(folder / "outside" / name, robot).recordings
    with np.load(folder / "truth" / f"{name}.npz", allow_pickle=False) as stored:
        truth = {key: stored[key] for key in stored.files}
    heldout = [runs[label] for label in given["heldout_runs"]] or list(runs.values())
    training = [runs[label] for label in given["training_runs"]] or list(runs.values())
    box = blackbox.fit(training)
    plants = {
        "nominal": Plant(nominal, chain_of(robot, ())),
        "retuned": built(late(given["retuned_late_s"]), given["retuned"], robot, nominal),
        "corrected": built(given["corrections"], given["simulator_parameters"], robot, nominal),
    }
    made = {}
    for split, chosen in (("heldout", heldout), ("outside", list(last))):
        apart = {"oracle": [seen(run) - truth[run.name] for run in chosen]}
        for model, plant in plants.items():
            try:
                apart[model] = [seen(run) - seen(replay(plant, run, dt_s)) for run in chosen]
            except SolverError as error:  # a model that cannot run is scored as the worst there is
                log.warning("%s of case %s does not run: %s", model, name, error)
        apart["blackbox"] = [seen(run) - box.predict(run) for run in chosen]
        made[split] = {model: rms_mm(rows) for model, rows in apart.items()}
    return made


def built(
    corrections: list[dict[str, Any]], parameters: dict[str, float], robot: Robot, nominal: PccSimulator
) -> Plant:
    """Return the simulator with the ``corrections`` and ``parameters`` of an answer."""
    effects = []
    for found in corrections:
        kind = effect_class(found["name"])
        fixed = {"chamber": found["chamber"]} if "chamber" in kind.__dataclass_fields__ else {}
        effects.append(kind(**found["parameters"], **fixed))
    return Plant(nominal.with_parameters(**parameters), chain_of(robot, effects))


def shuffled(
    source: Path, given: Answer, robot: Robot, nominal: PccSimulator, config: DiagnosisConfig, seed: int
) -> Answer:
    """Return what the diagnosis says of a case's recordings with a shuffled residual."""
    return diagnosed(
        lambda: without_relation(source, given, robot, nominal, config.numerics.dt_s, seed), robot, nominal, config
    )


def without_relation(
    source: Path, given: Answer, robot: Robot, nominal: PccSimulator, dt_s: float, seed: int
) -> RecordingSet:
    """Return recordings of the retuned simulator plus the case's own residual drawn anew, with its spectrum made smooth.

    The residual keeps its size and colour and loses all relation to the commands: there is nothing to be found. Without measured
    pressures a log may be late by one interval, beside them by one against each; what is later than that would be physics.
    """
    # the folder's name tells cases apart: of equal lengths all would draw the same phases, and count as one control
    recorded, rng, taken = read(source, robot), np.random.default_rng([seed, *source.name.encode()]), []
    interval_s = float(np.median([np.median(np.diff(run.time)) for run in recorded.recordings]))
    plant = built(late(min(given["retuned_late_s"], interval_s)), given["retuned"], robot, nominal)
    for run in recorded.recordings:
        predicted = seen(replay(plant, run, dt_s))
        left = seen(run) - predicted
        mixed = predicted + redrawn(left, rng)
        taken.append(replace(run, position=mixed, quaternion=None, pressure_meas=None))
    return replace(recorded, recordings=tuple(taken))


def seen(run: Recording) -> np.ndarray:
    """Return the tip (samples, 3) m of a run."""
    assert run.position is not None
    return run.position


def rms_mm(rows: list[np.ndarray]) -> float:
    """Return the rms norm of the rows, mm."""
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.concatenate(rows) ** 2, axis=1))))
