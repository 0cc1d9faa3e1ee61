"""What pays: errors on unseen runs, with intervals that respect how long errors stay alike."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from softrl.core.errors import ConfigError
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import axes_of
from softrl.diagnosis.series.blocks import MIN_BLOCKS, blocks_of, bootstrap_means, correlation_time, expanded
from softrl.effects.gate import WIDTHS
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording

SHOWN = 1.25  # times what counts: the first effect removes this much, in squares; less may be a detail of the body
SHOWN_BESIDE = 3.0  # the same where a retuned parameter stays at the end of its range: the body has another form
ROUNDED = 1e-3  # of the mean square: equal laws that were fitted apart differ by as much
ABRUPT_S = 0.5  # what takes longer to come about is not sudden
OVERLOOKED = 0.02  # of the noise's mean square: a difference that no data tell


@dataclass(frozen=True)
class Thresholds:
    """When an improvement counts.

    Attributes
    ----------
    material_share : of the travel (rms about its mean) of what is measured: less would not be noticed
    body_share : of the travel: as much a lumped body may leave of a robot that is no even rod; it is told, no verdict changes
    material_gain : an addition must lower the error above the noise floor by this share
    noise_share : an addition must remove at least this share of the rms that stays, which noise of any colour is part of
    explained_share : share of the squared error that can be explained which named effects must explain together
    confidence : of one-sided decisions and of two-sided parameter intervals, 0.5..1
    draws : of the block bootstrap
    block_s : shortest block
    """

    material_share: float
    body_share: float
    material_gain: float
    noise_share: float
    explained_share: float
    confidence: float
    draws: int
    block_s: float

    def __post_init__(self) -> None:
        for name in ("material_share", "body_share", "material_gain", "noise_share", "explained_share"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ConfigError(f"stage.thresholds.{name}={getattr(self, name):g}; expected a share in 0..1")
        if not 0.5 < self.confidence < 1.0:
            raise ConfigError(f"stage.thresholds.confidence={self.confidence:g}; expected 0.5 to 1")
        if self.draws < 100 or self.block_s <= 0.0:
            raise ConfigError(
                f"stage.thresholds.draws={self.draws}, block_s={self.block_s:g}; expected 100 or more, and positive"
            )


class Gap(NamedTuple):
    """Difference of two rms errors above the floor, and the bootstrap interval of it, m (Pa for pressures)."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Judge:
    """Scores squared errors on the runs of ``problem``.

    Attributes
    ----------
    problem : on runs that no fit saw
    floor : rms that noise alone leaves in a bin, m (Pa)
    travel : rms of what is measured about its mean, m (Pa)
    thresholds : when an improvement counts
    seed : of the bootstrap
    """

    problem: Problem
    floor: float
    travel: float
    thresholds: Thresholds
    seed: int

    def on(self, runs: Sequence[Recording]) -> "Judge":
        """Return the same judge of other runs."""
        return replace(self, problem=self.problem.on(runs))

    @property
    def material(self) -> float:
        """The smallest difference of errors that counts, m (Pa)."""
        return max(self.thresholds.material_share * self.travel, 0.25 * self.floor)

    @property
    def form(self) -> float:
        """The error that may be the body's form, m (Pa): of a lumped body more than of one that was made from a mesh."""
        lumped = self.problem.target == "motion" and isinstance(self.problem.simulator, PccSimulator)
        return max(self.material, self.thresholds.body_share * self.travel) if lumped else self.material

    def rms(self, squares: np.ndarray | float) -> float:
        """Return the rms error."""
        return float(np.sqrt(np.mean(squares)))

    def excess(self, mean_square: np.ndarray | float) -> Any:
        """Return the rms error above the floor of a mean square."""
        return np.sqrt(np.maximum(np.asarray(mean_square) - self.floor**2, 0.0))

    def gap(self, worse: np.ndarray, better: np.ndarray) -> Gap:
        """Return by how much ``better`` (bins,) lowers the error above the floor against ``worse`` (bins,)."""
        blocks = self._blocks(worse - better)
        draws, seed = self.thresholds.draws, self.seed
        a = self.excess(bootstrap_means(worse, blocks, draws, np.random.default_rng(seed)))
        b = self.excess(bootstrap_means(better, blocks, draws, np.random.default_rng(seed)))
        level = expanded(self.thresholds.confidence, blocks)
        low, high = np.quantile(a - b, [1.0 - level, level])
        return Gap(float(self.excess(worse.mean()) - self.excess(better.mean())), float(low), float(high))

    def pays(self, worse: np.ndarray, better: np.ndarray) -> bool:
        """Return whether ``better`` is better for sure, and by more than anybody would overlook."""
        gap = self.gap(worse, better)
        needed = max(self.material, self.thresholds.material_gain * float(self.excess(worse.mean())))
        return gap.low > 0.0 and gap.value >= needed and self.stands_out(worse, better)

    def shows(self, worse: np.ndarray, better: np.ndarray, times: float = SHOWN) -> bool:
        """Return whether ``better`` shows that something is missing where nothing was named yet.

        Beside coloured noise, or a second thing that is missing, the rms error hardly falls when the first is found: what
        is removed is measured in squares, and has to be more than the detail of a body, ``times`` what counts.
        """
        plain = self.removed(worse, better) >= times * self.material
        return self.gap(worse, better).low > 0.0 and plain and self.stands_out(worse, better)

    def stands_out(self, worse: np.ndarray, better: np.ndarray, times: float = 1.0) -> bool:
        """Return whether what ``better`` removes is as large as what counts, and beside what stays, noise of any colour.

        The floor knows white noise only; what stays after the best fit holds the rest of it.
        """
        return self.removed(worse, better) >= times * max(self.material, self.thresholds.noise_share * self.rms(better))

    def removed(self, worse: np.ndarray, better: np.ndarray) -> float:
        """Return the rms of what ``better`` (bins,) removes of ``worse`` (bins,), taken in squares."""
        return float(np.sqrt(max(worse.mean() - better.mean(), 0.0)))

    def tells(self, worse: np.ndarray, better: np.ndarray) -> bool:
        """Return whether the data tell that ``better`` is better, by more than what both leave could bring about.

        Where both leave structure behind, neither is the truth, and a difference that is small beside what is left
        says nothing about which of them is nearer to it. Nor does one that is nothing beside the noise: replays of equal
        laws differ by their time steps.
        """
        change = worse - better
        blocks = self._blocks(change)
        drawn = bootstrap_means(change, blocks, self.thresholds.draws, np.random.default_rng(self.seed))
        sure = np.quantile(drawn, 1.0 - expanded(self.thresholds.confidence, blocks)) > 0.0
        needed = ((1.0 + self.thresholds.material_gain) ** 2 - 1.0) * float(self.excess(better.mean())) ** 2
        return bool(sure and change.mean() >= max(needed, OVERLOOKED * self.floor**2))

    def simplest(self, trials: Sequence[Any]) -> Any:
        """Return the best trial, or a simpler one from which the data cannot tell it.

        What did come about suddenly is first of all what may. Then one with fewer free parameters is simpler, and a law than one
        that extends it; then what may come about suddenly, where something begins at a time. A map of many parameters, which has
        no physics, must pay against the best of the others.
        """
        best = min(trials, key=lambda trial: trial.mean_square)
        physics = [trial for trial in trials if not _by_map(trial)]
        if _by_map(best) and physics:
            other = min(physics, key=lambda trial: trial.mean_square)
            best = best if self.pays(other.squares, best.squares) else other
        alike = [t for t in trials if not self.tells(t.squares, best.squares)]
        return min(alike or [best], key=lambda t: (*_plainness(t), _alone(t), t.mean_square))

    def takes_over(self, other: Any, best: Any) -> bool:
        """Return whether ``other``, which data cannot tell from ``best``, is plainer, or as plain and better for sure."""
        mine, its = _plainness(best), _plainness(other)
        return its < mine or (its == mine and other.mean_square < (1.0 - ROUNDED) * best.mean_square)

    def _blocks(self, series: np.ndarray) -> np.ndarray:
        runs = self.problem.run_of_bin
        longest = max(correlation_time(series[runs == run]) for run in np.unique(runs))
        length = max(self.thresholds.block_s / self.problem.numerics.bin_s, 2.0 * longest)
        return blocks_of(runs, max(int(min(length, len(series) / MIN_BLOCKS)), 1))


def _by_map(trial: Any) -> bool:
    return effect_class(trial.hypothesis.effects[-1].name).together


def _plainness(trial: Any) -> tuple[int, int, int, int, int]:
    return len(too_sudden(trial)), len(trial.fit.point), _extended(trial), len(_strange(trial)), _picked(trial)


def _extended(trial: Any) -> int:
    return sum(bool(effect_class(choice.name).extends) for choice in trial.hypothesis.effects)


def _strange(trial: Any) -> list[Choice]:
    """Return the effects that begin at a time and are none that begin suddenly."""
    begun = [choice for choice in trial.hypothesis.effects if choice.gate and choice.gate.field == "since_s"]
    return [choice for choice in begun if not effect_class(choice.name).sudden]


def too_sudden(trial: Any) -> list[Choice]:
    """Return the effects of ``trial`` that begin suddenly, and are none that do."""
    return [choice for choice in _strange(trial) if takes_s(trial, choice) < ABRUPT_S]


def takes_s(trial: Any, choice: Choice) -> float:
    """Return how long it takes an effect of ``trial`` that begins at a time until it acts in full, s."""
    axes = axes_of(trial, choice)
    if WIDTHS["since_s"] not in axes:
        return np.inf
    axis, column = axes[WIDTHS["since_s"]]
    return axis.physical(float(trial.fit.point[column]))


def _picked(trial: Any) -> int:
    """Return how many numbers were left out: two that were picked from six say less than a law that has but two."""
    return sum(len(choice.pinned) for choice in trial.hypothesis.effects)


def _alone(trial: Any) -> int:
    return sum(choice.chamber >= 0 or bool(choice.sessions or choice.lasting) for choice in trial.hypothesis.effects)
