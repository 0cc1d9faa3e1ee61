"""`stage=paper`: the stages behind the paper's tables for several seeds, and their rows as ``paper.json``."""

import functools
import json
import logging
import operator
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from softrl.core.config import build
from softrl.core.errors import ConfigError, SoftrlError
from softrl.core.progress import progress
from softrl.core.store import write_text
from softrl.pipeline import Outcome, finished_before, outputs, run_stage
from softrl.report.paper import FULL_SIZE, collect, table_of

log = logging.getLogger(__name__)
BODY = ("mesh", "fem", "pod")
Compose = Callable[[list[str]], dict[str, Any]]
Made = dict[str, str]


@dataclass(frozen=True)
class Config:
    """Which runs stand behind the tables.

    Attributes
    ----------
    seeds : of everything that is learned or recorded;  body_seed : of mesh, fem and pod
    tasks : of stage rl;  rollouts : whether policies are rolled out on the driver
    corrected : whether the rollouts of task track are diagnosed, and what follows is done anew with the diagnosis
    benches : of stage bench, run once
    minutes : roughly, of all of it from nothing on two cores, or null where nobody knows
    keep : file that the rows are copied to, or null
    """

    seeds: tuple[int, ...]
    body_seed: int
    tasks: tuple[str, ...]
    rollouts: bool
    corrected: bool
    benches: tuple[str, ...]
    minutes: float | None
    keep: str | None

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise ConfigError(f"stage.seeds={list(self.seeds)}; expected one or more, all different")
        if self.corrected and not (self.rollouts and "track" in self.tasks):
            raise ConfigError("stage.corrected=true diagnoses the rollouts of task track: expected stage.rollouts=true and it")


class Step(NamedTuple):
    """One run: its name in the rows, its overrides, and the steps that it stands on, whose artifacts it takes."""

    name: str
    seed: int
    needs: tuple[str, ...]
    words: tuple[str, ...] = ()

    @property
    def stage(self) -> str:
        """The stage to run."""
        return self.name.split(":")[0]


class Runs:
    """Runs stages and keeps what they measured, and why one failed."""

    def __init__(self, shared: list[str], folder: Path, compose: Compose) -> None:
        self._shared, self._folder, self._compose = shared, folder, compose
        self.finished: list[Outcome] = []
        self.results: dict[str, list[dict[str, float]]] = {}
        self.why_not: dict[str, str] = {}
        self.commands: dict[str, str] = {}
        self._fresh_s: list[float] = []  # of the runs that were not reused

    def command(self, step: Step) -> str:
        """Return the command that repeats a step."""
        return " ".join(["python -m softrl", f"stage={step.stage}", *self._shared, *step.words])

    def left_out(self, steps: Sequence[Step], failed: set[str]) -> None:
        """Note of steps that were left out which failed ones they stand on."""
        for step in steps:
            on = ", ".join(sorted(failed & set(step.needs)))
            self.why_not.setdefault(step.name, f"seed {step.seed}: left out, since {on} failed")

    def estimate(self, runs: int) -> str:
        """Return in words how long ``runs`` more runs may take, by the mean of those that were run."""
        if not self._fresh_s:
            return ""
        minutes = runs * sum(self._fresh_s) / len(self._fresh_s) / 60.0
        return f", about {minutes:.0f} min left if the others take as long each"

    def go(self, step: Step, made: Made) -> str | None:
        """Run a step and return the id of its run, or None if it failed."""
        folder = self._folder / f"{step.name.replace(':', '_')}_{step.seed}"
        began = time.monotonic()
        try:
            outcome = run_stage(step.stage, self.configuration(step), folder, made)
        except Exception as error:  # hours of the other runs do not hang on it, whatever it is
            known = isinstance(error, SoftrlError)
            said = str(error) if known else f"{type(error).__name__}: {error}"
            log.warning("%s with seed %d failed: %s", step.name, step.seed, said, exc_info=not known)
            self.why_not[step.name] = f"seed {step.seed}: {said}"
            return None
        self.results.setdefault(step.name, []).append(outcome.metrics)
        self.finished.append(outcome)
        if not outcome.reused:
            self._fresh_s.append(time.monotonic() - began)
        return outcome.run_id

    def look(self, step: Step, made: Made) -> str | None:
        """Return the id of the run that a step would reuse, or None."""
        try:
            return finished_before(step.stage, self.configuration(step), made)
        except Exception:  # told when it is run
            return None

    def configuration(self, step: Step) -> dict[str, Any]:
        """Return the whole configuration of a step."""
        return self._compose([*self._shared, *step.words, f"seed={step.seed}", f"stage={step.stage}"])


def run_paper(cfg: Mapping[str, Any], words: list[str], folder: Path, compose: Compose) -> list[Outcome]:
    """Return the runs behind the tables after writing ``paper.json`` and ``paper.md`` to ``folder``."""
    config = build(cfg["stage"], Config, "stage")
    own = ("stage=", "stage.", "seed=", "task=", "out=")
    runs = Runs([w for w in words if not w.lstrip("+~").startswith(own)], folder, compose)
    body = body_steps(config, cfg["inputs"])
    waiting = _announce(runs, config, body, cfg["profile"]["name"])

    def go(step: Step, made: Made) -> str | None:
        """Run a step and write the rows: what is there is there, should the next one be stopped."""
        run_id = runs.go(step, made)
        waiting.discard(step)
        _write(runs, cfg, config, folder, waiting)
        return run_id

    made, failed = Made(), set[str]()
    follow(body, go, made, failed)
    for seed in progress(config.seeds, "seeds"):
        without = set(failed)
        follow(seed_steps(config, seed), go, dict(made), without)
        runs.left_out([step for step in seed_steps(config, seed) if step in waiting], without)
    _write(runs, cfg, config, folder, set())
    return runs.finished


def body_steps(config: Config, inputs: Mapping[str, str]) -> list[Step]:
    """Return the steps that all seeds share, less those whose artifacts are named."""
    steps, before = list[Step](), tuple[str, ...]()
    for stage in BODY:
        if all(inputs.get(name, "latest") != "latest" for name in outputs(stage)):
            log.info("%s: inputs name its artifacts; not run", stage)
            continue
        steps.append(Step(stage, config.body_seed, before))
        before = (stage,)
    return steps


def seed_steps(config: Config, seed: int) -> list[Step]:
    """Return the steps of everything that is learned or recorded with ``seed``."""
    steps = [Step(stage, seed, BODY) for stage in ("calibration", "dynamics", "surrogate")]
    for task in config.tasks:
        steps.append(Step(f"rl:{task}", seed, ("surrogate",), (f"task={task}",)))
        if config.rollouts:
            name = "sim2real" if task == "track" else f"sim2real:{task}"
            steps.append(Step(name, seed, ("calibration", f"rl:{task}"), (f"task={task}",)))
    if config.benches and seed == config.seeds[0] and config.tasks:
        last = f"task={config.tasks[-1]}"
        needs = ("calibration", f"rl:{config.tasks[-1]}")
        clock = "stage.clock=cpu"  # other work may share the machine
        steps.append(Step("bench", seed, needs, (f"bench=[{','.join(config.benches)}]", clock, last)))
    return steps + (corrected_steps(seed, config.tasks) if config.corrected else [])


def corrected_steps(seed: int, tasks: Sequence[str]) -> list[Step]:
    """Return the steps that diagnose the rollouts, and learn and calibrate anew in the simulator that this corrects.

    Of the tasks on a surface, which no policy learns in motion, the commands are planned through it; their policies are
    those of before.
    """
    words = ("effect=identified", "task=track")
    steps = [
        Step("diagnosis", seed, ("sim2real",)),
        Step("rl:corrected", seed, ("diagnosis",), words),
        Step("sim2real:corrected", seed, ("rl:corrected",), words),
    ]
    for task in (task for task in tasks if task != "track"):
        steps.append(Step(f"sim2real:corrected_{task}", seed, ("diagnosis", f"rl:{task}"), (words[0], f"task={task}")))
    return [*steps, Step("calibration:corrected", seed, ("diagnosis",), words[:1])]  # last: rollouts take the nominal f_RS


def follow(
    steps: Sequence[Step], do: Callable[[Step, Made], str | None], made: Made, failed: set[str]
) -> list[Step]:
    """Do the steps in order and return those done; ``made`` and ``failed`` grow, what stands on a failed one is left out.

    Of several artifacts of a kind a step takes that of a step it stands on, else the one made last.
    """
    done, by_step = [], dict[str, Made]()
    for step in steps:
        own = [by_step[name] for name in step.needs if name in by_step]
        run_id = None if failed & set(step.needs) else do(step, functools.reduce(operator.or_, own, dict(made)))
        if run_id is None:
            failed.add(step.name)
        else:
            by_step[step.name] = {kind: f"run:{run_id}" for kind in outputs(step.stage)}
            made |= by_step[step.name]
            done.append(step)
    return done


def _announce(runs: Runs, config: Config, body: list[Step], profile: str) -> set[Step]:
    """Say what will be done, what of it is there, and how long it may take; return what is not there.

    A task or a bench that does not exist ends it here, before hours of the runs that come first.
    """
    made, failed = Made(), set[str]()
    there, every = follow(body, runs.look, made, failed), list(body)
    for seed in config.seeds:
        steps = seed_steps(config, seed)
        every += steps
        there += follow(steps, runs.look, dict(made), set(failed))
    for step in {step.name: step for step in every}.values():
        runs.configuration(step)
        runs.commands[step.name] = runs.command(step)
    count = len(every)
    size = "full size" if profile == FULL_SIZE else f"reduced sizes; the paper's take profile={FULL_SIZE} and many hours"
    log.info("paper: %d runs for seeds %s, profile=%s (%s)", count, list(config.seeds), profile, size)
    takes = "an unknown time" if config.minutes is None else f"roughly {config.minutes:g} min on two cores"
    log.info("%d of them are there and are reused; from nothing all take %s", len(there), takes)
    log.info("stop it when you like: the same command goes on with the first run that is not finished")
    return set(every) - set(there)


def _write(runs: Runs, cfg: Mapping[str, Any], config: Config, folder: Path, waiting: set[Step]) -> None:
    later = {step.name: "not run yet: the same command goes on with it" for step in waiting}
    rows = collect(runs.results, later | runs.why_not, runs.commands, cfg["profile"]["name"])
    text = json.dumps(rows, indent=1)
    for place in (folder, *([Path(cfg["out"]).expanduser()] if cfg["out"] else [])):
        write_text(place / "paper.json", text)
        write_text(place / "paper.md", table_of(rows))
    if config.keep:
        write_text(Path(config.keep).expanduser(), text)
    measured = sum(row["ours_mean"] is not None for row in rows)
    left = f"; {len(waiting)} runs to go{runs.estimate(len(waiting))}" if waiting else ""
    log.info("paper: %d of %d rows measured, %s%s", measured, len(rows), folder / "paper.md", left)
