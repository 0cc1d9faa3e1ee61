"""Plan the pressure program that best tells hypotheses apart, within the robot's limits and a number of minutes."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis
from softrl.artifacts.excitation import Excitation
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.excite.block import Block, blocks
from softrl.excite.figures import draw_program, draw_separations
from softrl.excite.plan import (
    Effort,
    Pair,
    Program,
    Way,
    pairs_of,
    plan,
    program_of,
    refine,
    refitted_separation,
    score,
)
from softrl.excite.rival import rivals_of
from softrl.excite.separation import Sensing
from softrl.recordings.program import limited, random_steps
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.session import Identification, session_program
from softrl.recordings.store import DATASET, command_columns
from softrl.recordings.write import write
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)

SETTLED_SIGMA = 5.0  # a pair this far apart cannot be confused by noise alone


@dataclass(frozen=True)
class SensorNoise:
    """What the planned program's recordings will be like.

    Attributes
    ----------
    dt_s : step of the simulation and of the program
    sample_s : time between samples whose noise is independent; colour in the noise and error of the model make it longer
        than the period of the sensor
    position_mm : standard deviation of each coordinate of the tip; of an angle-only robot, of arc length
    pressure_kpa : of each measured chamber pressure, or null if none is measured
    """

    dt_s: float
    sample_s: float
    position_mm: float
    pressure_kpa: float | None


@dataclass(frozen=True)
class Usual(Identification):
    """The program of an identification as this stage's configuration names it."""

    key: ClassVar[str] = "stage.usual"


@dataclass(frozen=True)
class Config:
    """What to tell apart, and within what.

    Attributes
    ----------
    hypotheses : effects, as ``hysteresis``, ``lag+payload`` (both), ``gain@2`` (chamber 2), ``nothing``; empty to take
        those that a diagnosis left open
    minutes : length of the program
    rest_s : at zero pressure after each block
    runs : recordings of the program that the dataset in ``out`` asks for; a diagnosis needs two or more
    size : of the listed effects relative to their typical strength; parameters of shape stay
    tuned_factor : a rival may change the simulator's parameters by this factor either way
    sensing : noise and sampling
    effort : how hard to search
    usual : the program beside which the planned one is judged, as in stage=sim2real
    out : folder of a dataset with the commands, or null
    seed : of the multisines and random steps
    """

    hypotheses: tuple[str, ...]
    minutes: float
    rest_s: float
    runs: int
    size: float
    tuned_factor: float
    sensing: SensorNoise
    effort: Effort
    usual: Usual
    out: str | None
    seed: int

    def __post_init__(self) -> None:
        for name in ("minutes", "rest_s", "runs", "size"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        if self.tuned_factor <= 1.0:
            raise ConfigError(f"stage.tuned_factor={self.tuned_factor:g} must be above 1")
        noise = self.sensing
        silent = noise.pressure_kpa is not None and noise.pressure_kpa <= 0.0
        if min(noise.dt_s, noise.sample_s, noise.position_mm) <= 0.0 or silent:
            raise ConfigError(
                f"stage.sensing: dt_s={noise.dt_s:g}, sample_s={noise.sample_s:g}, position_mm={noise.position_mm:g}, "
                f"pressure_kpa={noise.pressure_kpa}; expected positive numbers, or null for pressure_kpa"
            )
        try:
            replace(self.usual, dt_s=noise.dt_s)  # its tones and triangles have to stand such steps, too
        except ConfigError as error:
            raise ConfigError(f"stage.sensing.dt_s={noise.dt_s:g} is too long: {error}") from error
        for name in ("shortlist", "repeats", "fit_evaluations"):
            if getattr(self.effort, name) < 1:
                raise ConfigError(f"stage.effort.{name}={getattr(self.effort, name)}; expected 1 or more")


def run(
    config: Config, robot: Robot, simulator: Simulator, diagnosis: Diagnosis | None, *, tracker: Tracker
) -> Excitation:
    """Return the program that separates the hypotheses best, beside what the usual one and a random one achieve."""
    noise = config.sensing
    pressure_pa = None if noise.pressure_kpa is None else 1e3 * noise.pressure_kpa
    sensing = Sensing(noise.dt_s, noise.sample_s, 1e-3 * noise.position_mm, pressure_pa)
    # a row acts until its time or from then on: as a diagnosis will have it
    rivals = rivals_of(config.hypotheses, diagnosis, robot, simulator, config.tuned_factor, config.size, noise.dt_s)
    candidates, count = blocks(robot, noise.dt_s, config.rest_s, config.seed), round(60.0 * config.minutes / noise.dt_s)
    shortest = min(len(block.pressure) for block in candidates)
    if count < shortest:
        raise ConfigError(
            f"stage.minutes={config.minutes:g} is too short: the shortest block lasts {noise.dt_s * shortest:.0f} s"
        )
    usual = usual_program(robot, config.usual, noise.dt_s, count, config.seed)
    pairs = pairs_of(rivals, usual, sensing, config.effort)
    chosen = plan(pairs, candidates, sensing, 60.0 * config.minutes, config.effort)
    hold = max(round(2.0 / noise.dt_s), 1)
    random = random_steps(robot, count // hold + 1, 2.0, noise.dt_s, np.random.default_rng(config.seed))[1][:count]
    programs = {
        "planned": program_of(chosen),
        "default": program_of([Block("usual program", usual)]),
        "random": program_of([Block("random steps of 2 s", random)]),
    }
    apart = {name: _separations(pairs, program, sensing) for name, program in programs.items()}
    programs["planned"], apart["planned"] = _refined(programs, apart, pairs, candidates, robot, sensing, config)
    excitation = _conclude(robot, pairs, programs["planned"], apart, sensing)
    _report(robot, excitation, tracker)
    return excitation


def write_out(config: Config, robot: Robot, excitation: Excitation) -> None:
    """Write the commands to the folder ``config.out``, if one is named; the pipeline calls this for a reused run, too."""
    if config.out is not None:
        write_commands(Path(config.out).expanduser(), robot, excitation, config.runs)


def usual_program(robot: Robot, usual: Identification, dt_s: float, count: int, seed: int) -> np.ndarray:
    """Return ``count`` rows (count, chambers) Pa of the usual sessions, one after the other, at steps of ``dt_s``."""
    rng = np.random.default_rng(seed)
    rows: list[np.ndarray] = []
    while sum(map(len, rows)) < count:
        time, pressure = session_program(robot, usual, len(rows), rng)
        wanted = dt_s * np.arange(1, int(time[-1] / dt_s) + 1)
        rows.append(pressure[np.searchsorted(time, wanted - 1e-9).clip(max=len(time) - 1)])
    return limited(robot, np.vstack(rows)[:count], dt_s)  # picked at other steps, or cut between two sessions, it may jump


def require_own(folder: Path) -> None:
    """Raise ``ConfigError`` if ``folder`` holds another dataset, or commands beside which something was recorded."""
    if folder.is_file():
        raise ConfigError(f"out={folder} is a file; expected a folder")
    if (folder / DATASET).is_file() and "planned_by" not in (folder / DATASET).read_text():
        raise ConfigError(f"out={folder} holds a dataset that was not planned by stage=excite; choose another folder")
    for path in sorted(folder.glob("*.csv")):
        measured = [name for name in path.read_text().partition("\n")[0].split(",") if name != "time_s" and "_cmd" not in name]
        if measured:
            raise ConfigError(f"out={folder}: {path.name} holds more than commands ({measured[0]}); choose another folder")


def write_commands(folder: Path, robot: Robot, excitation: Excitation, runs: int) -> None:
    """Write a dataset that holds commands only, one file a recording that is asked for, see ``require_own``."""
    require_own(folder)
    for earlier in folder.glob("*.csv") if (folder / DATASET).is_file() else ():
        earlier.unlink()
    named = [
        Recording(f"excite_{k + 1}", f"session_{k + 1}", excitation.time, excitation.pressure) for k in range(runs)
    ]
    write(folder, RecordingSet(robot.name, tuple(named), {"planned_by": "stage=excite"}), robot)
    log.info("wrote %d runs of commands to %s", runs, folder)


def _separations(pairs: list[Pair], program: Program, sensing: Sensing) -> list[float]:
    """Return how far apart each pair stays under a program, in sigma."""
    return [refitted_separation(pair, program.pressure, sensing) for pair in pairs]


def _refined(
    programs: dict[str, Program],
    apart: dict[str, list[float]],
    pairs: list[Pair],
    candidates: list[Block],
    robot: Robot,
    sensing: Sensing,
    config: Config,
) -> tuple[Program, list[float]]:
    """Return the best program, the baselines included, with pieces exchanged while that helps, and its separations."""
    best = max(apart, key=lambda name: score(apart[name]))
    log.info("the search goes on from the %s program", best)
    rng = np.random.default_rng(config.seed)
    refined = refine(pairs, candidates, programs[best], robot, sensing, config.effort, rng)
    after = _separations(pairs, refined, sensing)
    return (refined, after) if score(after) >= score(apart[best]) else (programs[best], apart[best])


def _conclude(
    robot: Robot, pairs: list[Pair], planned: Program, apart: dict[str, list[float]], sensing: Sensing
) -> Excitation:
    return Excitation(
        robot_name=robot.name,
        time=sensing.dt_s * np.arange(1, len(planned.pressure) + 1),
        pressure=planned.pressure,
        blocks=planned.segments(sensing.dt_s),
        pairs=[
            {
                "first": pair.labels[0],
                "second": pair.labels[1],
                "name": pair.name,
                "parameters": {way.truth.label: _values(way) for way in pair.ways},
                "separation_sigma": {name: values[k] for name, values in apart.items()},
            }
            for k, pair in enumerate(pairs)
        ],
    )


def _values(way: Way) -> dict[str, float]:
    """Return the parameters of the truth, with the effect before the name."""
    found = {}
    for axis, u in zip(way.truth.axes, way.at_truth, strict=True):
        owner = "simulator" if axis.effect < 0 else way.truth.effects[axis.effect].name()
        found[f"{owner}.{axis.name}"] = axis.physical(float(u))
    return found


def _report(robot: Robot, excitation: Excitation, tracker: Tracker) -> None:
    for pair in excitation.pairs:
        apart = pair["separation_sigma"]
        tracker.metric(f"separation_{pair['name']}_sigma", apart["planned"])
        for name in ("default", "random"):
            tracker.metric(f"{name}/separation_{pair['name']}_sigma", apart[name])
        log.info(
            "%s against %s: %.3g sigma apart after refitting (usual program %.3g, random steps %.3g)%s",
            pair["first"], pair["second"], apart["planned"], apart["default"], apart["random"],
            "" if apart["planned"] >= SETTLED_SIGMA else "; no program found tells them apart: sense more or load the tip",
        )  # fmt: skip
    tracker.metric("program_s", float(excitation.time[-1]))
    tracker.text("excite.csv", csv_text(robot, excitation))
    tracker.figure("program", draw_program(excitation))
    tracker.figure("separations", draw_separations(excitation.pairs))


def csv_text(robot: Robot, excitation: Excitation) -> str:
    """Return the program as a recording's file with commands only, those that the robot takes."""
    names, columns = zip(*command_columns(excitation.pressure, robot), strict=True)
    rows = np.column_stack([excitation.time, *columns])
    return "\n".join([",".join(["time_s", *names]), *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n"
