"""Blind trials of the diagnosis: hidden physics from other equations, a sealed key, one attempt a case."""

import csv
import io
import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from softrl.artifacts.proof import Proof
from softrl.core import fingerprint
from softrl.core.errors import ConfigError
from softrl.core.progress import progress
from softrl.core.tracking import Tracker
from softrl.diagnosis.stage import Config as DiagnosisConfig
from softrl.pcc.simulator import PccSimulator
from softrl.proof import figures, score
from softrl.proof.generator.catalogue import frozen
from softrl.proof.generator.plan import plan
from softrl.proof.judging import answer, shuffled, worth
from softrl.proof.ledger import digest, open_key, require_untouched, seal, text_of
from softrl.proof.shelf import kept
from softrl.proof.trial import Generator, make, of_case
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Nominal:
    """What the nominal simulator is told of the robot; the generator's body is built from the same numbers.

    Attributes
    ----------
    bend_at_full_pressure_rad, elongation_at_full_pressure, damping_s : as in ``simulator=pcc``
    """

    bend_at_full_pressure_rad: float
    elongation_at_full_pressure: float
    damping_s: float


@dataclass(frozen=True)
class Config:
    """Blind trials.

    Attributes
    ----------
    cases : how many
    detectable : rms of a hidden effect after retuning, over the noise floor, from which it is called detectable
    shuffled_cases : controls with a residual that has lost all relation to the commands
    workers : processes, one case each
    folder : where cases are kept, so that a proof that was stopped goes on
    generator : numbers of the hidden robots
    nominal : numbers of the simulator that is diagnosed
    diagnosis : configuration of the diagnosis on trial
    seed : of the cases
    """

    cases: int
    detectable: float
    shuffled_cases: int
    workers: int
    folder: str
    generator: Generator
    nominal: Nominal
    diagnosis: DiagnosisConfig
    seed: int

    def __post_init__(self) -> None:
        if self.cases < 1 or self.shuffled_cases < 0 or self.workers < 1:
            raise ConfigError(
                f"stage.cases={self.cases}, shuffled_cases={self.shuffled_cases}, workers={self.workers}; "
                "expected 1, 0, 1 or more"
            )
        if self.generator.sessions < 3:
            raise ConfigError(
                f"stage.generator.sessions={self.generator.sessions}; expected 3 or more, one is held out"
            )


@dataclass(frozen=True)
class Shelf:
    """Where everything of one proof stands; a folder's name is the hash of what it holds depends on."""

    cases: Path
    answers: Path


def run(config: Config, robot: Robot, *, tracker: Tracker) -> Proof:
    """Return how well the diagnosis does on robots with hidden physics that it has not seen and cannot look up."""
    if robot.output == "bend_angle":
        raise ConfigError(
            f"robot={robot.name} reports bend_angle, and hidden robots are recorded by the tip's position; choose a robot whose "
            "output is tip_position or tip_pose"
        )
    nominal = PccSimulator(robot, **asdict(config.nominal), bending_stiffness_scale=1.0, axial_stiffness_scale=1.0,
                           mass_scale=1.0)  # fmt: skip
    shelf = _shelf(config, robot)
    trials = plan(config.cases, config.seed)
    parts = [shelf.cases / "sealed" / f"{case.number:04d}.json" for case in trials]
    key = _each(make, [(case, config.generator, robot, nominal, shelf.cases) for case in trials], parts, config.workers,
                "recording robots with hidden physics")  # fmt: skip
    sealed = seal(shelf.cases / "key.json", key)
    ledger: dict[str, Any] = {"cases": config.cases, "seed": config.seed, "detectable": config.detectable,
                              "catalogue_sha256": frozen(), "key_sha256": sealed}  # fmt: skip
    log.info("answer key sealed: SHA-256 %s; table of right answers %s", sealed, frozen()[:16])
    _write(tracker, ledger)

    folders = sorted(entry["folder"] for entry in key)
    given = _diagnose(config, shelf, folders, robot, nominal)
    controls = _controls(config, shelf, folders, given, robot, nominal)
    ledger |= {"answers_sha256": digest(given), "answers": given, "controls": controls}
    _write(tracker, ledger)

    opened = open_key(shelf.cases / "key.json", sealed)
    require_untouched(shelf.cases, opened, of_case)
    errors = _judge(config, shelf, folders, given, robot, nominal)
    rows = [score.row_of(e, given[e["folder"]], errors[e["folder"]], config.detectable) for e in opened]
    finds = sum(found["verdict"] != "nothing missing" for found in controls.values())
    metrics = score.metrics(rows, finds, len(controls))
    _write(tracker, ledger | {"key": opened, "shares": {k: v._asdict() for k, v in score.shares(rows).items()}})
    return _report(config, robot, rows, metrics, sealed, tracker)


def _shelf(config: Config, robot: Robot) -> Shelf:
    """Return the folders of this proof: cases depend on the generator, answers also on the diagnosis."""
    made = [config.cases, config.seed, asdict(config.generator), asdict(config.nominal), asdict(robot)]
    code = fingerprint.of_code("softrl.proof.trial", "softrl.proof.generator.plan")
    cases = Path(config.folder) / fingerprint.of_values([*made, code])
    engine = fingerprint.of_code("softrl.diagnosis.stage", "softrl.proof.judging")
    return Shelf(cases, cases / f"answers-{fingerprint.of_values([asdict(config.diagnosis), engine])}")


def _diagnose(
    config: Config, shelf: Shelf, folders: Sequence[str], robot: Robot, nominal: PccSimulator
) -> dict[str, Any]:
    """Return folder -> answer; all that a diagnosis is given are the recordings and what is known of the robot."""
    jobs = [(shelf.cases / "recordings" / name, robot, nominal, config.diagnosis) for name in folders]
    places = [shelf.answers / f"{name}.json" for name in folders]
    return dict(zip(folders, _each(answer, jobs, places, config.workers, "diagnosing"), strict=True))


def _controls(
    config: Config, shelf: Shelf, folders: Sequence[str], given: dict[str, Any], robot: Robot, nominal: PccSimulator
) -> dict[str, Any]:
    """Return folder -> answer to the case's recordings with a shuffled residual."""
    able = [name for name in folders if given[name].get("retuned")][: config.shuffled_cases]
    jobs = [
        (shelf.cases / "recordings" / name, given[name], robot, nominal, config.diagnosis, config.seed) for name in able
    ]
    places = [shelf.answers / f"shuffled-{name}.json" for name in able]
    return dict(zip(able, _each(shuffled, jobs, places, config.workers, "shuffled controls"), strict=True))


def _judge(
    config: Config, shelf: Shelf, folders: Sequence[str], given: dict[str, Any], robot: Robot, nominal: PccSimulator
) -> dict[str, Any]:
    dt_s = config.diagnosis.numerics.dt_s
    jobs = [(shelf.cases, name, given[name], robot, nominal, dt_s) for name in folders]
    places = [shelf.answers / f"worth-{name}.json" for name in folders]
    return dict(zip(folders, _each(worth, jobs, places, config.workers, "judging"), strict=True))


def _each(
    work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], places: Sequence[Path], workers: int, title: str
) -> list[Any]:
    """Return ``work(*job)`` of every job, each kept at its place as soon as it is done, and not done twice."""
    calls = [joblib.delayed(kept)(work, job, place) for job, place in zip(jobs, places, strict=True)]
    if workers == 1:
        return [function(*args) for function, args, _ in progress(calls, title)]
    pool = joblib.Parallel(n_jobs=workers, return_as="generator", inner_max_num_threads=1)
    return list(progress(pool(calls), title, total=len(calls)))


def _write(tracker: Tracker, ledger: dict[str, Any]) -> None:
    tracker.text("ledger.json", text_of(ledger))


def _report(
    config: Config, robot: Robot, rows: list[score.Row], metrics: dict[str, float], sealed: str, tracker: Tracker
) -> Proof:
    for name, value in metrics.items():
        if np.isfinite(value):
            tracker.metric(name, value)
    tracker.text("proof.csv", table(rows))
    tracker.figure("confusion", figures.confusion(rows))
    tracker.figure("detection", figures.detection(rows, config.detectable))
    tracker.figure("errors_by_stratum", figures.errors(rows))
    wrong = score.misses(rows)
    tracker.text("misses.txt", "\n".join(wrong) + "\n")
    log.info("%d of %d cases went wrong; they are listed in misses.txt", len(wrong), len(rows))
    finite = {name: value if np.isfinite(value) else None for name, value in metrics.items()}
    return Proof(robot.name, finite, rows, wrong, sealed, frozen())


def table(rows: Sequence[score.Row]) -> str:
    """Return the rows as CSV, one a case."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()
