"""What effects leave on held-out runs: how much of it they explain, and whether the rest is structure or noise."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.fitting.flexible import correction, pressures
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.fitting.judge import Gap, Judge
from softrl.diagnosis.fitting.problem import Problem, Residual
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.fitting.varied import slopes, varied
from softrl.diagnosis.judging.locate import corrected, locate
from softrl.diagnosis.series.changing import WINDOW_S, follows_at_times
from softrl.diagnosis.series.moments import at_moments
from softrl.diagnosis.series.noise import unlike_noise
from softrl.diagnosis.series.repeats import repeats
from softrl.diagnosis.series.spectrum import spectral_line
from softrl.effects.library import effect_class

NOISE_LEVEL = 0.01  # chance of what is left under noise of its own spectrum
NOISE_DRAWS = 500
CHANGING_LEVEL, CHANGING_DRAWS = 0.002, 1000  # likewise of what follows the pressures in ways that change
MOMENT_LEVEL = 1e-3  # likewise of what comes at moments
LINE_LEVEL = 1e-8  # chance of a line in the spectrum of noise
UNDRIVEN_SHARE = 0.5  # of the squared error: effects that remove less explain nothing
UNKNOWN_TIMES = 1.2  # what is missing must stand out more than what is named: nobody can check it
REST_FACTOR = 2.5  # times what counts: what is left beside effects that explain most of it, and is no detail of them
LOUD = 0.1  # of the motion: nobody records with noise as loud as this
LOUD_BESIDE = 0.25  # the same beside effects that explain most of it, whose form may differ
NEARLY_ALL = 0.9  # of the squared error: effects whose laws have no other form explain it, or leave a third of the error
FOLLOWING_FACTOR = 3.0  # times what counts: structure below this may be a detail of the body
CARRIES = 3.0  # times what is left on the runs of the fit: what leaves more on others was bent to fit
UNEVEN_FACTOR = 2.0  # times what counts: what jumps, or is all that follows the pressures; less is a detail of the body
FOLLOWING_LEVEL = 1e-3


class Offer(NamedTuple):
    """A map without physics from pressures and their past to what is left: its held-out gain, and whether it pays.

    ``fitted`` is the mean square that is left on the runs of the fit, m^2 (Pa^2).
    """

    gap: Gap
    pays: bool
    squares: np.ndarray
    fitted: float


def heldout_residual(judge: Judge, trial: Trial) -> Residual:
    """Return what a trial leaves on the judge's runs, as it was placed."""
    return judge.problem.residual(trial.hypothesis, trial.fit.point, trial.placed)


def offer_of(problem: Problem, judge: Judge, trial: Trial) -> Offer:
    """Return what a map from pressures and their past to the residual, fitted on the runs of ``problem``, removes held out."""
    training = problem.residual(trial.hypothesis, trial.fit.point, trial.placed)
    heldout = heldout_residual(judge, trial)
    offered = correction(problem, training.runs, judge.problem)
    runs = [values - extra for values, extra in zip(heldout.runs, offered, strict=True)]
    squares = Residual(runs, {}).squares
    fitted = float(training.squares.mean())
    return Offer(judge.gap(trial.squares, squares), judge.pays(trial.squares, squares), squares, fitted)


def varies(problem: Problem, judge: Judge, trial: Trial) -> bool:
    """Return whether effects whose laws have no other form would need numbers that follow the pressures, held out.

    Fitted on the runs of ``problem``. Where other effects are named besides, what varies may be a detail of these.
    """
    if not trial.hypothesis.effects or not all(effect_class(name).exact for name in trial.hypothesis.names):
        return False
    heldout, changes = heldout_residual(judge, trial), varied(problem, trial, judge.problem)
    squares = Residual([values - change for values, change in zip(heldout.runs, changes, strict=True)], {}).squares
    return judge.shows(trial.squares, squares)


def pieces_of_course(effects: Sequence[Choice]) -> list[str]:
    """Return the names of those among ``effects`` that depend on the time alone and act in the same place, if there are two.

    Steps and ramps together make up any course of time, as a polynomial does any curve: what swings with the warmth of a day
    is a failure between two drifts then.
    """
    timed = [choice for choice in effects if effect_class(choice.name).lasts]
    apart = {choice.chamber for choice in timed}
    return [choice.label() for choice in timed] if len(timed) > 1 and (len(apart) < len(timed) or -1 in apart) else []


class Explained(NamedTuple):
    """Share of the squared error that can be explained, and of all of it, which effects explain; error above the floor left."""

    share: float
    of_all: float
    left: float


def explained_by(judge: Judge, base: Trial, final: Trial, offer: Offer) -> Explained:
    """Return how much of the squared error of ``base`` the effects of ``final`` explain.

    What can be explained is what the effects remove, and beyond them what a map without physics could remove or what
    follows the pressures in different ways. Effects that remove less than ``UNDRIVEN_SHARE`` of the whole have to answer
    for the whole.
    """
    whole, left = float(judge.excess(base.mean_square)), float(judge.excess(final.mean_square))
    removed = whole**2 - left**2
    of_all = removed / whole**2 if whole > 0.0 else 0.0
    if of_all <= UNDRIVEN_SHARE:
        return Explained(of_all, of_all, left)
    mapped = left**2 - float(judge.excess(offer.squares.mean())) ** 2 if offer.pays else 0.0
    changing = _changing(judge, heldout_residual(judge, final)) if left > judge.material else 0.0
    return Explained(removed / (removed + max(mapped, min(changing, left**2))), of_all, left)


def not_understood(problem: Problem, judge: Judge, final: Trial, offer: Offer, explained: Explained) -> list[str]:
    """Return why ``final``, fitted on the runs of ``problem``, is no identification, one clause each; empty if it is."""
    reasons = reasons_of(judge, final, offer, explained)
    if not reasons and varies(problem, judge, final):
        return ["the numbers of the effects named would have to change with the pressures"]
    if not reasons and (pieces := pieces_of_course(final.hypothesis.effects)):
        return [f"{' and '.join(pieces)} depend on the time alone: steps and ramps together describe any course of it"]
    return reasons


def reasons_of(judge: Judge, final: Trial, offer: Offer, explained: Explained) -> list[str]:
    """Return why the effects do not explain what is measured, one clause each; empty if they do.

    Noise with a memory is no reason: what is left has to follow the pressures, to be a line in the spectrum, or to be
    unlike noise of its own spectrum: a valve that sticks for moments leaves little in all, but nearly all of it then. Where
    effects explain most of it, what is left must follow the pressures plainly, or, where that is less than they should
    explain, be no noise: a wall's law may differ in its form, and leave some of that, a turned frame may not, and a map
    without physics excuses nothing. What holds for the runs of the fit alone is not understood.
    """
    left = explained.left
    if left <= judge.material:
        return []
    mostly = explained.of_all >= judge.thresholds.explained_share
    if left > (LOUD_BESIDE if mostly else LOUD) * judge.travel:
        return [f"what is left is {left / judge.travel:.0%} of the motion, more than any sensor's noise"]
    fitted = max(float(judge.excess(offer.fitted)), judge.material)
    if final.hypothesis.effects and left > REST_FACTOR * judge.material and left > CARRIES * fitted:
        return [f"what the effects named leave is {left / fitted:.1f} times as large on runs that no fit saw"]
    follows = offer.pays and judge.stands_out(final.squares, offer.squares, UNKNOWN_TIMES)
    drives, heldout, reasons = _drives(judge), heldout_residual(judge, final), []
    if explained.share >= judge.thresholds.explained_share:
        laws = [effect_class(name) for name in final.hypothesis.names]
        if follows and (left > REST_FACTOR * judge.material or all(law.exact for law in laws)):
            return ["what the effects named leave follows the pressures and their past"]
        if left <= REST_FACTOR * judge.material:
            return []
        enough = NEARLY_ALL if all(law.exact or law.together for law in laws) else judge.thresholds.explained_share
        uneven = explained.of_all < enough and _uneven(judge, final, heldout, drives, 1.0)
        return ["what the effects named leave is no noise: it jumps, or grows where the pressures move"] if uneven else []
    if follows and (final.hypothesis.effects or left > UNEVEN_FACTOR * judge.material):
        reasons.append("what is left follows the pressures and their past")
    elif left > FOLLOWING_FACTOR * judge.material and (region := _followed(judge, heldout)):
        reasons.append(f"what is left follows the pressures and their past ({region})")
    elif _changing(judge, heldout) > (FOLLOWING_FACTOR * judge.material) ** 2:
        reasons.append("what is left follows the pressures, but not always in the same way")
    elif left > judge.floor and (line := spectral_line(heldout.runs, drives)).chance < LINE_LEVEL:
        rate_hz = line.cycles / judge.problem.spacing_s
        reasons.append(f"what is left swings at one frequency, {rate_hz:.2g} Hz: record at rest, and see if it swings there, too")
    elif left > UNEVEN_FACTOR * judge.material and _uneven(judge, final, heldout, drives, UNEVEN_FACTOR):
        reasons.append("what is left is no noise: it jumps, or grows where the pressures move")
    elif left > UNEVEN_FACTOR * judge.material and _momentary(judge, heldout):
        reasons.append("what is left is no noise: it comes at a few moments")
    elif left > FOLLOWING_FACTOR * judge.material and _repeated(judge, heldout):
        reasons.append("what is left is the same wherever a chamber's pressure is")
    return reasons


def _drives(judge: Judge) -> list[np.ndarray]:
    return [pressures(judge.problem, k) for k in range(len(judge.problem.runs))]


def _changing(judge: Judge, residual: Residual) -> float:
    """Return the mean square of what follows the pressures within windows, zero if noise may do so."""
    window = max(round(WINDOW_S / judge.problem.numerics.bin_s), 1)
    rng = np.random.default_rng(judge.seed)
    found = follows_at_times(residual.runs, _drives(judge), window, CHANGING_DRAWS, rng)
    return found.share * float(residual.squares.mean()) if found.p_value < CHANGING_LEVEL else 0.0


def _repeated(judge: Judge, residual: Residual) -> bool:
    """Return whether what comes again with the pressure of a chamber is no noise, and plainly larger than what counts."""
    found = repeats(residual.runs, _drives(judge), CHANGING_DRAWS, np.random.default_rng(judge.seed))
    size = np.sqrt(found.share) * judge.rms(residual.squares)
    return bool(found.p_value < CHANGING_LEVEL and size > FOLLOWING_FACTOR * judge.material)


def _followed(judge: Judge, residual: Residual) -> str:
    """Return in words what the residual follows beyond chance, or nothing."""
    rows = corrected(locate(judge.problem, residual, judge.floor, ""))
    share = FOLLOWING_FACTOR * judge.material / judge.rms(residual.squares)
    least = max(share, UNKNOWN_TIMES * judge.thresholds.noise_share)
    rows = [row for row in rows if row["effect_size"] > least]
    named = [row for row in rows if row["p_value"] < FOLLOWING_LEVEL and row["region"] not in (None, "band")]
    if not named:
        return ""
    chamber = f", chamber {named[0]['chamber']}" if named[0]["chamber"] else ""
    return f"{named[0]['region']}{chamber}"


def _uneven(judge: Judge, trial: Trial, residual: Residual, drives: list[np.ndarray], times: float) -> bool:
    """Return whether ``residual`` is no noise of any colour, whatever the parameters are.

    Any body differs a little from the robot's, sharply where pressures move, and what is loud beside it may be noise:
    what is uneven has to be large itself, ``times`` what counts.
    """
    rng = np.random.default_rng(judge.seed)
    found = unlike_noise(residual.runs, drives, NOISE_DRAWS, rng, slopes(judge.problem, trial, residual))
    large = np.sqrt(found.share) * judge.rms(residual.squares) > times * judge.material
    return bool(large and found.p_value < NOISE_LEVEL)


def _momentary(judge: Judge, residual: Residual) -> bool:
    """Return whether what comes at a few moments is no noise, and plainly larger than what counts."""
    share = at_moments(residual.runs, MOMENT_LEVEL)
    return bool(np.sqrt(share) * judge.rms(residual.squares) > UNEVEN_FACTOR * judge.material)
