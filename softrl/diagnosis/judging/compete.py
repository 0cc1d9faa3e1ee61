"""The competitors of a correction: nominal, retuned, one lag, maps without physics, the calibrated map; all judged alike."""

from dataclasses import replace

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.simulator import Simulator
from softrl.diagnosis.checks.data import Data
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, fit_trials, of_effects
from softrl.diagnosis.judging.baselines import one_lag, without_physics
from softrl.diagnosis.judging.correct import Model, Traces, model_of, traces
from softrl.diagnosis.judging.ends import rejected_nominal
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.hidden import behind, in_words, read_map
from softrl.diagnosis.judging.join import tuned_together
from softrl.pcc.simulator import PccSimulator


def competitors(search: Search, training: Problem, findings: list[Finding], mass_factor: float) -> dict[str, Model]:
    """Return nominal, retuned and corrected, all from command to motion.

    What is retuned alone may have any mass within ``mass_factor``, though effects were named beside one that a scale would show.
    """
    empty = Hypothesis((), ())
    tuned = training.tuned
    motion = findings[-1]
    start = tuned_together(findings[0].base, motion.base)
    parts = [finding.final for finding in findings]
    effects = tuple(choice for trial in parts for choice in trial.hypothesis.effects)
    free = replace(training, numerics=replace(training.numerics, mass_factor=mass_factor)) if effects else training
    retuned = fit_trials(free, None, [(Hypothesis((), tuned), [start])], search)[0]
    point = np.concatenate([*(of_effects(trial) for trial in parts), tuned_together(parts[0], parts[-1])])
    if not effects:
        point = retuned.fit.point
    elif motion.joint is not None:
        point = motion.joint
    lag = one_lag(free, retuned.fit.point, search)
    judge = _judge(training, findings)
    nominal, plain, corrected = (
        model_of(training, *model)
        for model in ((empty, np.zeros(0)), (retuned.hypothesis, retuned.fit.point), (Hypothesis(effects, tuned), point))
    )
    plain = plain._replace(ends=rejected_nominal(training, judge, plain, search))
    ends = rejected_nominal(training, judge, corrected, search) if effects else plain.ends
    models = {"nominal": nominal, "retuned": plain, "corrected": corrected._replace(ends=ends)}
    return models | ({"one_lag": lag} if lag else {})


def _judge(training: Problem, findings: list[Finding]) -> Judge:
    """Return the judge from command to motion on held-out runs, with the thresholds and the noise of the motion's own."""
    part, judge = findings[-1].part, findings[-1].judge
    problem = training.on(findings[0].part.heldout)
    return Judge(problem, part.floor_of(problem), part.travel, judge.thresholds, judge.seed)


def judged_on(
    whole: Problem, data: Data, models: dict[str, Model], workers: int, given: Simulator
) -> dict[str, dict[str, Traces]]:
    """Return what every competitor predicts, with physics and without: split -> name -> traces.

    The nominal one is the simulator as it was ``given``: a length that was said wrongly is an error of it.
    """
    splits = {split: whole.on(runs) for split, runs in data.splits.items()}
    plain = without_physics(whole.on(data.training), splits, models["corrected"].placed)
    nominal = {split: replace(problem, simulator=given) for split, problem in splits.items()}
    jobs = [((nominal if name == "nominal" else splits)[s], model) for s in splits for name, model in models.items()]
    made = iter(parallel(traces, jobs, 1 if isinstance(whole.simulator, PccSimulator) else workers))
    return {split: {name: next(made) for name in models} | plain[split] for split in splits}


def add_calibrated(
    whole: Problem,
    data: Data,
    calibration: Calibration,
    retuned: Model,
    judged: dict[str, dict[str, Traces]],
    search: Search,
) -> None:
    """Add what the retuned simulator behind the calibrated map predicts to ``judged``."""
    training = behind(whole.on(data.training), calibration)
    fitted = fit_trials(training, None, [(retuned.hypothesis, [retuned.point])], search)
    if fitted:
        model = model_of(training, retuned.hypothesis, fitted[0].fit.point)
        for split, runs in data.splits.items():
            judged[split]["calibrated"] = traces(behind(whole.on(runs), calibration), model)


def with_map(diagnosis: Diagnosis, calibration: Calibration) -> Diagnosis:
    """Return the diagnosis with what the calibrated map has absorbed, and whether physics replaces it."""
    rows, unit = read_map(calibration), "deg" if diagnosis.errors_deg else "mm"
    held = (diagnosis.errors_deg or diagnosis.errors_mm)["heldout"]
    lines = in_words(rows)
    if "calibrated" in held:
        replaces = bool(diagnosis.effects) and held["corrected"] <= held["calibrated"]
        lines.append(
            f"Behind the calibrated map the retuned simulator errs by {held['calibrated']:.3g} {unit} on held-out runs; "
            + (
                f"the physics named here, without the map, by {held['corrected']:.3g} {unit}, and replaces it."
                if replaces
                else f"without it the corrected one by {held['corrected']:.3g} {unit}: the map stays."
            )
        )
    data = diagnosis.data | {"calibrated_map": rows}
    return replace(diagnosis, sentences=[*diagnosis.sentences, *lines], data=data)
