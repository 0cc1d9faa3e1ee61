"""Find where recordings and simulator part, name the physics that is missing, and correct the simulator."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.diagnosis.checks.cost import warn_of_cost
from softrl.diagnosis.checks.data import Data, Refusal, prepare, require_robot
from softrl.diagnosis.checks.frames import in_other_frames, sagging_alike
from softrl.diagnosis.checks.prelude import preludes
from softrl.diagnosis.checks.quality import mixed
from softrl.diagnosis.checks.within import within
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge, Thresholds
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.diagnosis.fitting.step import suited
from softrl.diagnosis.fitting.trial import Search
from softrl.diagnosis.judging.along import along_the_body
from softrl.diagnosis.judging.another_body import with_its_length, with_its_mass, with_its_taper
from softrl.diagnosis.judging.clock import sent_later
from softrl.diagnosis.judging.compete import add_calibrated, competitors, judged_on, with_map
from softrl.diagnosis.judging.correct import Traces, share_closed
from softrl.diagnosis.judging.days import by_days, mounted_apart, says_more, stiffer_on
from softrl.diagnosis.judging.examine import Finding, Part, examine
from softrl.diagnosis.judging.gauges import behind_gauges
from softrl.diagnosis.judging.join import joined, put_together
from softrl.diagnosis.judging.locate import corrected, locate
from softrl.diagnosis.judging.own import differing, told_of
from softrl.diagnosis.judging.parts import both_at_once, part_behind, punctual, valve_part
from softrl.diagnosis.judging.quieter import quieter, supposed
from softrl.diagnosis.judging.unbelieved import clipping, doubtful, tells_more, told_of_unbelieved
from softrl.diagnosis.telling.conclusion import cannot_tell, conclude, in_short
from softrl.diagnosis.telling.figures import draw_all
from softrl.diagnosis.telling.report import page
from softrl.effects.library import names
from softrl.recordings.mistaken import mistaken
from softrl.recordings.recording import RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
QUIETER = 3  # times that the noise may turn out to be less than was thought


@dataclass(frozen=True)
class Config:
    """The protocol's numbers.

    Attributes
    ----------
    candidates : effects to consider, "all" for the whole library
    numerics : steps and bounds of the replays
    search : how hard to look
    thresholds : when an improvement counts
    heldout_share : share of the sessions (of the runs, with two sessions or fewer) that judge
    measured_pressure : use measured pressure where every run has it, to examine valve and body apart
    orientation : compare orientations too where every run has them; a lumped body's are no better than its shape
    seed : of the split and the bootstrap
    """

    candidates: tuple[str, ...]
    numerics: Numerics
    search: Search
    thresholds: Thresholds
    heldout_share: float
    measured_pressure: bool
    orientation: bool
    seed: int

    def __post_init__(self) -> None:
        for name in ("dt_s", "rough_dt_s", "bin_s"):
            if getattr(self.numerics, name) <= 0.0:
                raise ConfigError(f"stage.numerics.{name}={getattr(self.numerics, name):g} s must be positive")
        number = self.numerics
        if number.settle_s < 0.0 or min(number.tuned_factor, number.mass_factor) <= 1.0:
            raise ConfigError(
                f"stage.numerics.settle_s={number.settle_s:g}, tuned_factor={number.tuned_factor:g}, "
                f"mass_factor={number.mass_factor:g}; expected 0 s or more, and above 1 each"
            )
        if not 0.0 < self.heldout_share < 1.0:
            raise ConfigError(f"stage.heldout_share={self.heldout_share:g} must lie between 0 and 1")
        unknown = [name for name in self.candidates if name != "all" and name not in names()]
        if unknown:
            raise ConfigError(f"stage.candidates: effect '{unknown[0]}' is unknown; expected all, {', '.join(names())}")

    @property
    def effects(self) -> list[str]:
        """Names of the effects to consider."""
        return names() if "all" in self.candidates else list(self.candidates)


class Evidence(NamedTuple):
    """What the figures of a diagnosis are drawn from: the held-out runs, findings, and what competitors predict there."""

    heldout: Problem
    findings: list[Finding]
    traces: dict[str, Traces]


def run(
    config: Config,
    robot: Robot,
    recordings: RecordingSet,
    simulator: Simulator,
    calibration: Calibration | None = None,
    *,
    tracker: Tracker,
) -> Diagnosis:
    """Return what the simulator leaves out, with evidence, rivals, and what rebuilds the corrected simulator.

    A ``calibration`` is a competitor: the retuned simulator behind the calibrated map of pressures. What the map has
    absorbed is told, and whether physics predicts held-out runs at least as well.
    """
    diagnosis, evidence = diagnose(config, robot, recordings, simulator, calibration)
    _report(diagnosis, evidence, tracker)
    return diagnosis


def diagnose(
    config: Config, robot: Robot, recordings: RecordingSet, simulator: Simulator, calibration: Calibration | None = None
) -> tuple[Diagnosis, Evidence | None]:
    """Return the diagnosis as ``run`` does, and what its figures are drawn from: nothing where the data cannot tell.

    Where that is unknown, and a session that was held out whole differs from the others in itself, whole runs of every session
    are held out instead: what acted on one day alone can be named then.
    """
    require_robot(recordings, robot)
    config = replace(config, search=config.search.begun())
    found = prepare(recordings, robot, config.heldout_share, config.seed)
    if isinstance(found, Refusal):
        return cannot_tell(found, robot.name, type(simulator).__name__), None
    diagnosis, evidence = _asked_again(config, robot, recordings, found, simulator, calibration)
    return diagnosis if config.search.in_time else in_short(diagnosis, config.search.minutes), evidence


def _asked_again(
    config: Config, robot: Robot, recordings: RecordingSet, found: Data, simulator: Simulator, calibration: Calibration | None
) -> tuple[Diagnosis, Evidence | None]:
    """Return the diagnosis and its evidence, asked again where what it leaves may be how sessions differ, while there is time."""
    found, diagnosis, evidence = _heard(config, robot, found, simulator, calibration)
    if evidence and config.search.in_time and _may_be_mounts(diagnosis, evidence.findings[-1]):
        log.info("sessions seem to be mounted a little otherwise each: all is examined again with each placed by itself")
        again = _diagnosed(config, robot, found, simulator, calibration, stiffer_on(evidence.findings[-1]))
        if again[1] and again[0].verdict != "unknown" and says_more(again[1].findings[-1], evidence.findings[-1]):
            return again
    odd = differing(evidence.findings[-1], found.used) if evidence and diagnosis.verdict == "unknown" else []
    if not odd or not config.search.in_time:
        return diagnosis, evidence
    log.info("%s", told_of(odd))
    inside = prepare(recordings, robot, config.heldout_share, config.seed, few_sessions=len(found.used))
    if isinstance(inside, Refusal):
        return diagnosis, evidence
    again = _diagnosed(config, robot, replace(inside, noise=found.noise, mended=found.mended), simulator, calibration)
    if not again[0].effects or again[0].verdict == "unknown":
        return diagnosis, evidence
    return replace(again[0], sentences=[*again[0].sentences, told_of(odd)]), again[1]


def _may_be_mounts(diagnosis: Diagnosis, finding: Finding) -> bool:
    """Return whether what is not understood, or is put down to the days, may be how the base was mounted."""
    by_days_only = finding.days is not None and not finding.days.beside
    return (diagnosis.verdict == "unknown" or by_days_only) and mounted_apart(finding)


def _heard(
    config: Config, robot: Robot, found: Data, simulator: Simulator, calibration: Calibration | None
) -> tuple[Data, Diagnosis, Evidence | None]:
    """Return the data with the noise that is left when the best model is found, and the diagnosis with it.

    What is missing hides behind noise that is told too loud. Where rows may be too slow to tell it from motion, less is supposed
    once: a model that errs by less on held-out runs then shows that it is.
    """
    diagnosis, evidence = _believing(config, robot, found, simulator, calibration)
    for _ in range(QUIETER):
        heard = quieter(found, diagnosis) if config.search.in_time else None
        if heard is None and found.at_most and config.search.in_time:
            log.info("rows may be too slow to tell noise from motion: all is examined with less noise")
            heard = quieter(found, _believing(config, robot, supposed(found), simulator, calibration)[0])
        if heard is None:
            break
        log.info("%s", heard.mended[-1])
        found = heard
        diagnosis, evidence = _believing(config, robot, found, simulator, calibration)
    return found, diagnosis, evidence


def _believing(
    config: Config, robot: Robot, found: Data, simulator: Simulator, calibration: Calibration | None
) -> tuple[Diagnosis, Evidence | None]:
    """Return the diagnosis with gauges, or the answer without them where the motion contradicts them."""
    with_gauges = _diagnosed(config, robot, found, simulator, calibration)
    clips = clipping(found.used, robot)
    if not config.search.in_time or not doubtful(with_gauges[0], clips):
        return with_gauges
    log.info("gauges may not show what acts on the body: all is examined again without them")
    diagnosis, evidence = _diagnosed(replace(config, measured_pressure=False), robot, found, simulator, calibration)
    if not tells_more(diagnosis, with_gauges[0]):
        return with_gauges
    verdict_first, *others = diagnosis.sentences
    told = told_of_unbelieved(diagnosis, with_gauges[0], clips)
    return replace(diagnosis, sentences=[verdict_first, told, *others]), evidence


def _diagnosed(
    config: Config, robot: Robot, found: Data, simulator: Simulator, calibration: Calibration | None,
    days: dict[str, float] | None = None,
) -> tuple[Diagnosis, Evidence | None]:
    """Return the diagnosis; with ``days`` every session is placed by itself, and stiffer by as much as they say, by session."""
    numerics = _steps(config, robot, simulator, found)
    seconds, _ = config.search.bounds_of(simulator)
    data = found.shortened(seconds * numerics.dt_s / config.numerics.dt_s)
    whole, data = _whole(config, robot, simulator, data, numerics)
    whole = whole if days is None else replace(whole, mounted=True, stiffer=days)
    apart = _contradiction(whole, found)
    if apart:
        return cannot_tell(Refusal(data.check, apart, data.mended), robot.name, type(simulator).__name__), None

    def examined(problem: Problem, known: list[Finding]) -> list[Finding]:
        return _examine(config, problem, data, found, known)

    pipeline = both_at_once(whole, data, config.effects)
    judge = pipeline.judge(data.training, config.thresholds, config.seed)
    whole, findings = with_its_length(whole, data, judge, pipeline.choices, examined, config.search)
    whole, findings = with_its_mass(whole, findings, examined, config.search)
    whole, findings = with_its_taper(whole, findings, examined, config.search)
    if config.search.in_time:
        findings = behind_gauges(
            findings,
            lambda gauges: _valve(config, whole, found, gauges),
            lambda valve: examined(whole, [valve])[-1],
            config.search,
        )
    whole = put_together(whole, findings)
    findings = joined(whole.on(data.training), findings, config.search, config.thresholds)
    models = competitors(config.search, whole.on(data.training), findings, numerics.mass_factor)
    judged = judged_on(whole, data, models, config.search.workers, simulator)
    if calibration is not None:
        add_calibrated(whole, data, calibration, models["retuned"], judged, config.search)
    located = [f for part in findings for f in _locate(part)]
    diagnosis = conclude(data, whole, findings, models, judged, corrected(located))
    if calibration is not None:
        diagnosis = with_map(diagnosis, calibration)
    return diagnosis, Evidence(whole.on(data.heldout), findings, judged["heldout"])


def _steps(config: Config, robot: Robot, simulator: Simulator, data: Data) -> Numerics:
    """Return the numerics with the longest steps that the robot's motion allows."""
    drive = "measured" if data.pressure and config.measured_pressure else "command"
    part = within(data.training, config.search.fit_s)
    body = Problem(robot, simulator, part, config.numerics, "motion", drive, False, False)
    warn_of_cost(body, config.search.workers)
    floor = body.floor(data.noise, data.rounding)
    numerics = suited(body, Judge(body, floor, data.travel, config.thresholds, config.seed).material)
    if numerics != config.numerics:
        log.info("steps of %.3g s, and of %.3g s to rank, suit the motion and its rows", numerics.dt_s, numerics.rough_dt_s)
    return numerics


def _whole(
    config: Config, robot: Robot, simulator: Simulator, data: Data, numerics: Numerics
) -> tuple[Problem, Data]:
    """Return the problem from command to motion, with registration if sessions use different frames, and what is told of these.

    One that was held out whole is placed by its own runs, like any other: else the split would decide what is said.
    """
    turns = config.orientation and data.orientation
    bare = Problem(robot, simulator, data.training, numerics, "motion", "command", False, turns)
    runs = [run for part in data.splits.values() for run in part]
    interval_s = 0.0 if data.punctual else data.period_s
    bare = replace(bare, late_max_s=interval_s, interval_s=interval_s, before=preludes(data.training, runs, robot))
    if robot.output != "bend_angle":
        nominal = bare.on(data.used).replayed(Hypothesis((), ()), np.zeros(0))
        data = sagging_alike(data, nominal, robot)
        if in_other_frames(nominal, data.used, data.misplaced):
            return replace(bare, register=True, orientation=False), data
    return replace(bare, before=preludes(data.training, runs, robot, one_frame=True)), data


def _contradiction(whole: Problem, data: Data) -> str | None:
    """Return why the runs cannot be what they are said to be, beside what the simulator does under their commands."""
    runs = tuple(run for part in data.splits.values() for run in part)
    made = whole.on(runs).replayed(Hypothesis((), ()), np.zeros(0))
    return mistaken(runs, made, whole.robot) or mixed(data.training, made[: len(data.training)], whole.robot)


def _examine(config: Config, whole: Problem, data: Data, full: Data, known: list[Finding]) -> list[Finding]:
    """Return the findings of valve and body apart where pressure is measured, else of the whole pipeline.

    The valve alone is simulated in no time, so that its fits see the ``full`` length of the runs. Its finding may be ``known``.
    """
    if not (data.pressure and config.measured_pressure):
        return [by_days(_look(config, both_at_once(whole, data, config.effects)))]
    valve = known[0] if known else _valve(config, whole, full)
    return [valve, by_days(_look(config, part_behind(valve, whole, data, config.effects)))]


def _valve(config: Config, whole: Problem, full: Data, gauges: Sequence[Choice] = ()) -> Finding:
    return punctual(_look(config, valve_part(whole, full, config.effects, gauges)))


def _look(config: Config, part: Part) -> Finding:
    """Return what is missing in a part; where that is unknown, with commands as another clock may have sent them."""
    finding = examine(part, config.search, config.thresholds, config.seed)
    later = sent_later(finding) if finding.unknown and config.search.in_time else {}
    if not later:
        return finding
    log.info("commands may have been sent by another clock than the log's: %s is examined with their times free", part.title)
    timed = replace(part, problem=replace(part.problem, later=later))
    again = examine(timed, config.search, config.thresholds, config.seed)
    return finding if again.unknown else again


def _locate(finding: Finding) -> list[Any]:
    problem = finding.part.problem
    residual = problem.residual(finding.base.hypothesis, finding.base.fit.point, finding.base.placed)
    found = locate(problem, residual, finding.part.floor_of(problem), finding.part.title)
    return found + (along_the_body(problem, finding.base, finding.part.title) if problem.target == "motion" else [])


def _report(diagnosis: Diagnosis, evidence: Evidence | None, tracker: Tracker) -> None:
    if evidence is None:
        log.warning("%s", diagnosis.sentences[0])
        for line in diagnosis.data["warnings"]:
            log.warning("about the data: %s", line)  # of warnings that are alike the first few are shown
        tracker.text("report.html", page(diagnosis, {}))
        return
    for split, values in diagnosis.errors_mm.items():
        for name, error in values.items():
            tracker.metric(f"{split}/{name}_error_mm", error)
    for split, values in diagnosis.errors_deg.items():
        for name, error in values.items():
            tracker.metric(f"{split}/{name}_error_deg", error)
    if (share := share_closed(diagnosis.errors_mm["heldout"])) is not None:
        tracker.metric("heldout/gap_closed_share", share)
    tracker.metric("effects_named_count", len(diagnosis.effects))
    for sentence in diagnosis.sentences:
        log.info("%s", sentence)
    for line in diagnosis.data["warnings"]:
        log.warning("%s", line)
    figures = draw_all(diagnosis, *evidence)
    tracker.text("report.html", page(diagnosis, figures))
    for name, figure in figures.items():
        tracker.figure(name, figure)
