"""Find where recordings and simulator part, name the physics that is missing, and correct the simulator."""

import logging
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.diagnosis.compete import add_calibrated, competitors, judged_on, with_map
from softrl.diagnosis.correct import Model, Traces, errors, in_mm, share_closed
from softrl.diagnosis.data import (
    OTHER_FRAME_RAD,
    TURNED_FRAME_RAD,
    Data,
    Refusal,
    other_frames,
    prepare,
    require_robot,
    turned_frame,
    within,
)
from softrl.diagnosis.examine import Finding, Part, examine
from softrl.diagnosis.explain import (
    effect_entries,
    next_experiment,
    retuned_entries,
    rival_entries,
    sentences,
    unexplained,
    verdict_of,
)
from softrl.diagnosis.figures import draw_all
from softrl.diagnosis.hypothesis import Hypothesis, candidates, in_one_session
from softrl.diagnosis.join import joined
from softrl.diagnosis.judge import Judge, Thresholds
from softrl.diagnosis.locate import corrected, locate
from softrl.diagnosis.mistaken import mistaken
from softrl.diagnosis.prelude import preludes
from softrl.diagnosis.problem import ORIENTATION_LEVER, Numerics, Problem
from softrl.diagnosis.quality import mixed
from softrl.diagnosis.report import page
from softrl.diagnosis.response import step_responses
from softrl.diagnosis.step import suited
from softrl.diagnosis.trial import Search
from softrl.effects.effect import SITES
from softrl.effects.library import names
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
VALVE_STEPS = 4  # of a valve to one of the body: it costs little, and pressures are measured well


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
        if self.numerics.settle_s < 0.0 or self.numerics.tuned_factor <= 1.0:
            raise ConfigError(
                f"stage.numerics.settle_s={self.numerics.settle_s:g}, tuned_factor={self.numerics.tuned_factor:g}; "
                "expected 0 s or more, and above 1"
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
    require_robot(recordings, robot)
    found = prepare(recordings, robot, config.heldout_share, config.seed)
    if isinstance(found, Refusal):
        return _cannot_tell(found, robot, simulator, tracker)
    longer = _with_step(config, robot, simulator, found)
    seconds = config.search.fit_lumped_s if isinstance(simulator, PccSimulator) else config.search.fit_s
    data = found.shortened(seconds * longer.numerics.dt_s / config.numerics.dt_s)
    config = longer
    whole = _whole(config, robot, simulator, data)
    apart = _contradiction(whole, found)
    if apart:
        return _cannot_tell(Refusal(data.check, apart), robot, simulator, tracker)
    findings = _examine(config, whole, data, found)
    findings = joined(whole.on(data.training), findings, config.search, config.thresholds)
    models = competitors(config.search, whole.on(data.training), findings)
    judged = judged_on(whole, data, models)
    if calibration is not None:
        add_calibrated(whole, data, calibration, models["retuned"], judged, config.search)
    located = [f for part in findings for f in _locate(part)]
    diagnosis = _conclude(config, data, whole, findings, models, judged, corrected(located))
    if calibration is not None:
        diagnosis = with_map(diagnosis, calibration)
    _report(diagnosis, config, data, whole, findings, judged, tracker)
    return diagnosis


def _with_step(config: Config, robot: Robot, simulator: Simulator, data: Data) -> Config:
    """Return the configuration with the longest steps that the robot's motion allows."""
    drive = "measured" if data.pressure and config.measured_pressure else "command"
    part = within(data.training, config.search.fit_s)
    body = Problem(robot, simulator, part, config.numerics, "motion", drive, False, False)
    material = Judge(
        body, _floor_in_bin(data.noise, data, config), data.travel, config.thresholds, config.seed
    ).material
    numerics = suited(body, material)
    if numerics != config.numerics:
        log.info("the motion is slow: steps of %g s, and of %g s to rank", numerics.dt_s, numerics.rough_dt_s)
    return replace(config, numerics=numerics)


def _whole(config: Config, robot: Robot, simulator: Simulator, data: Data) -> Problem:
    """Return the problem from command to motion, with registration if sessions use different frames."""
    turns = config.orientation and data.orientation
    bare = Problem(robot, simulator, data.training, config.numerics, "motion", "command", False, turns)
    bare = replace(bare, before=preludes(data.training, [r for runs in data.splits.values() for r in runs], robot))
    if robot.output == "bend_angle":
        return bare
    nominal = bare.replayed(Hypothesis((), ()), np.zeros(0))
    apart, turned = other_frames(nominal, data.training), turned_frame(nominal, data.training)
    if apart < OTHER_FRAME_RAD and turned < TURNED_FRAME_RAD and not data.misplaced:
        return bare
    log.info(
        "sessions use frames that turn apart by %.0f deg, and all by %.0f deg against the base frame, or have another "
        "origin: each is placed by itself",
        np.degrees(apart),
        np.degrees(turned),
    )
    return replace(bare, register=True, orientation=False)


def _contradiction(whole: Problem, data: Data) -> str | None:
    """Return why the runs cannot be what they are said to be, beside what the simulator does under their commands."""
    runs = tuple(run for part in data.splits.values() for run in part)
    made = whole.on(runs).replayed(Hypothesis((), ()), np.zeros(0))
    return mistaken(runs, made, whole.robot) or mixed(data.training, made[: len(data.training)], whole.robot)


def _examine(config: Config, whole: Problem, data: Data, full: Data) -> list[Finding]:
    """Return the findings of valve and body apart where pressure is measured, else of the whole pipeline.

    The valve alone is simulated in no time, so that its fits see the ``full`` length of the runs.
    """
    if not (data.pressure and config.measured_pressure):
        return [_examine_motion(config, whole, data, "command to motion", SITES)]
    valve = _examine_valve(config, whole, full)
    body = replace(
        data,
        training=_without_bias(whole.runs, valve, whole),
        heldout=_without_bias(data.heldout, valve, whole),
    )
    before = preludes(body.training, (*body.training, *body.heldout), whole.robot)
    behind = replace(whole, drive="measured", runs=body.training, before=before)
    sites = tuple(site for site in SITES if site != "valve")
    return [valve, _examine_motion(config, behind, body, "measured pressure to motion", sites)]


def _examine_valve(config: Config, whole: Problem, data: Data) -> Finding:
    steps = whole.numerics
    finer = replace(steps, dt_s=steps.dt_s / VALVE_STEPS, rough_dt_s=steps.rough_dt_s / VALVE_STEPS)
    problem = replace(whole, target="pressure", register=False, orientation=False, runs=data.training, numerics=finer)
    choices = candidates(config.effects, ("valve",), whole.robot, data.check.excited)
    floor = _floor_in_bin(data.pressure_noise, data, config)
    part = Part("command to measured pressure", problem, data.heldout, floor, data.pressure_travel,
                (), tuple(choices))  # fmt: skip
    return examine(part, config.search, config.thresholds, config.seed)


def _examine_motion(config: Config, problem: Problem, data: Data, title: str, sites: tuple[str, ...]) -> Finding:
    wanted = [name for name in config.effects if not (problem.register and name == "frame")]
    choices = in_one_session(wanted, *([run.session for run in side] for side in (data.training, data.heldout)))
    choices += candidates(wanted, sites, problem.robot, data.check.excited)
    turned = ORIENTATION_LEVER * problem.robot.length_m * data.turn_noise if problem.orientation else 0.0
    floor = _floor_in_bin(float(np.hypot(data.noise, turned)), data, config)
    part = Part(title, problem.on(data.training), data.heldout, floor, data.travel,
                tuple(problem.simulator.parameters), tuple(choices))  # fmt: skip
    return examine(part, config.search, config.thresholds, config.seed)


def _floor_in_bin(noise: float, data: Data, config: Config) -> float:
    """Return the rms that white noise leaves in the mean of a bin."""
    period = float(np.median([run.period_s for run in data.check.runs]))
    return noise / float(np.sqrt(max(config.numerics.bin_s / period, 1.0)))


def _without_bias(runs: tuple[Any, ...], valve: Finding, whole: Problem) -> tuple[Any, ...]:
    """Return the runs with the constant offset of each measured pressure taken out, as far as the valve explains it.

    A command that is no pressure, or a valve that is not understood, says nothing about a sensor's zero.
    """
    if whole.robot.command != "pressure" or valve.unknown:
        return tuple(runs)
    problem = replace(valve.part.problem, runs=tuple(runs))
    supplied = problem.replayed(valve.final.hypothesis, valve.final.fit.point)
    shifted = []
    for run, made in zip(runs, supplied, strict=True):
        bias = (run.pressure_meas - made.pressure_meas).mean(axis=0)
        shifted.append(replace(run, pressure_meas=run.pressure_meas - bias))
    return tuple(shifted)


def _locate(finding: Finding) -> list[Any]:
    problem = finding.part.problem
    residual = problem.residual(finding.base.hypothesis, finding.base.fit.point, finding.base.placed)
    return locate(problem, residual, finding.part.floor, finding.part.title)


def _conclude(
    config: Config,
    data: Data,
    whole: Problem,
    findings: list[Finding],
    models: dict[str, Model],
    judged: dict[str, dict[str, Traces]],
    located: list[dict[str, Any]],
) -> Diagnosis:
    robot, angle = whole.robot, whole.robot.output == "bend_angle"
    noise = data.noise / (robot.length_m if angle else 1.0)
    plain = {split: errors(found, noise) for split, found in judged.items()}
    verdict, responses = verdict_of(findings), step_responses(data.training)
    space = whole.space(models["corrected"].hypothesis)
    made = Diagnosis(
        robot_name=robot.name,
        simulator_name=type(whole.simulator).__name__,
        verdict=verdict,
        sentences=[],
        effects=effect_entries(findings, whole),
        simulator_parameters=space.tuned(models["corrected"].point),
        retuned=retuned_entries(whole, models["retuned"], config.numerics.tuned_factor),
        rivals=rival_entries(findings, robot),
        located=located,
        errors_mm={split: in_mm(values, robot.length_m, angle) for split, values in plain.items()},
        errors_deg={s: {n: float(np.degrees(e)) for n, e in v.items()} for s, v in plain.items()} if angle else {},
        unexplained=unexplained(findings),
        next_experiment=next_experiment(findings, verdict, robot, data.noise),
        data={
            "warnings": _warnings(data, whole),
            "training_runs": [r.name for r in data.training],
            "heldout_runs": [r.name for r in data.heldout],
            "sessions_placed_separately": whole.register,
            "orientation_used": whole.orientation,
            "measured_pressure_used": len(findings) > 1,
            "step_responses": asdict(responses),
        },
    )
    read = responses.sentence()
    return replace(made, sentences=sentences(made, findings) + ([read] if read else []))


def _warnings(data: Data, whole: Problem) -> list[str]:
    """Return what is odd about the recordings, one line each."""
    lines = [*data.check.warnings, *data.mended]
    if whole.register:
        lines.append(
            "the recorded frame differs from the robot's base frame, or between sessions: every session is placed by "
            "the rigid motion that fits best, so that a tilt or an offset of the frame cannot be told"
        )
    return lines


def _report(
    diagnosis: Diagnosis,
    config: Config,
    data: Data,
    whole: Problem,
    findings: list[Finding],
    judged: dict[str, dict[str, Traces]],
    tracker: Tracker,
) -> None:
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
    figures = draw_all(diagnosis, whole.on(data.heldout), findings, judged["heldout"])
    tracker.text("report.html", page(diagnosis, figures))
    for name, figure in figures.items():
        tracker.figure(name, figure)


def _cannot_tell(refusal: Refusal, robot: Robot, simulator: Simulator, tracker: Tracker) -> Diagnosis:
    """Return the diagnosis of data that cannot tell anything."""
    sentence = f"Cannot tell: {refusal.reason}."
    log.warning("%s", sentence)
    diagnosis = Diagnosis(
        robot_name=robot.name,
        simulator_name=type(simulator).__name__,
        verdict="unknown",
        sentences=[sentence],
        effects=[],
        simulator_parameters={},
        retuned={},
        rivals=[],
        located=[],
        errors_mm={"train": {}, "heldout": {}},
        errors_deg={},
        unexplained={"cannot_tell": refusal.reason},
        next_experiment=None,
        data={"warnings": list(refusal.check.warnings)},
    )
    tracker.text("report.html", page(diagnosis, {}))
    return diagnosis
