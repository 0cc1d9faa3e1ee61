"""The energies that may be fitted, judged by cross-validation, and which of them is taken."""

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from itertools import islice
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.pod.fitting.energy import Normal, accumulate, scale_of, solve, trust
from softrl.pod.fitting.equilibria import Equilibria
from softrl.pod.fitting.maps import ALWAYS
from softrl.pod.fitting.settings import FitSettings
from softrl.pod.fitting.settling import equilibria_of, settles, stands
from softrl.pod.fitting.symmetry import ALIKE, reflected, weight_to_trust
from softrl.pod.rom import static_points
from softrl.pod.step.tables import tables_of
from softrl.robots.robot import Robot
from softrl.robots.symmetry import images_of

LOST = 0.1  # of the rms motion: an equilibrium farther off counts as lost, however far it is


class Choice(NamedTuple):
    """A candidate energy, with the rms error m of the tip at equilibria that its fit did not see, weighed by trust."""

    image_weight: float
    anchor_weight: float
    degree: int
    ridge: float
    tip_error_m: float


class Candidates:
    """The energies that may be fitted: each is the solution of one set of normal equations.

    Attributes
    ----------
    image_weights : those that make a difference
    """

    def __init__(self, settings: FitSettings, robot: Robot, draft: ReducedModel, samples: Equilibria, fold: np.ndarray):
        self._settings, self._draft, self._samples, self._fold = settings, draft, samples, fold
        self._scale, images = scale_of(samples), images_of(robot)
        self.image_weights = settings.image_weights_of(robot)
        self._trusted = trust(samples, draft.frame, self._scale, settings.energy_degree_max, settings.weights)
        parts = [(samples.rows(here), self._trusted[here]) for here in (fold == k for k in (*range(settings.folds), ALWAYS))]
        self._own = [self._equations(*part) for part in parts]
        self._images = [
            self._equations(reflected(part, images), np.tile(trusted, len(images))) for part, trusted in parts
        ] if images else []  # fmt: skip
        self._anchors: np.ndarray | None = None
        self._low: list[np.ndarray] = []
        self._sums: dict[float, list[Normal]] = {}

    def _equations(self, samples: Equilibria, trusted: np.ndarray) -> Normal:
        settings = self._settings
        return accumulate(samples, trusted, self._draft.frame, self._scale, settings.energy_degree_max, settings.weights)

    def anchor(self, choice: Choice, loads: np.ndarray) -> None:
        """Take the equilibria under ``loads`` of the energy ``choice``, each fold's of its own fit, as anchors."""
        self._low = [self.energy(choice, left_out) for left_out in (None, *range(self._settings.folds))]
        anchors = equilibria_of(replace(self._draft, energy=self._low[0]), loads)
        alike = np.ones(len(anchors.load))
        self._anchors = self._equations(anchors, alike).matrix * (len(self._samples.load) / len(anchors.load))

    def energy(self, choice: Choice, left_out: int | None = None) -> np.ndarray:
        """Return the coefficients (monomials,) J of ``choice``, fitted to all samples but those of one fold."""
        matrix, right = self._seen(choice.image_weight)[0 if left_out is None else 1 + left_out]
        if choice.anchor_weight and self._anchors is not None:
            low = self._low[0 if left_out is None else 1 + left_out][self._draft.order + 1 :]
            matrix = matrix + choice.anchor_weight * self._anchors
            right = right + choice.anchor_weight * (self._anchors[:, : len(low)] @ low)
        return solve(Normal(matrix, right), self._draft.order, choice.degree, choice.ridge)

    def _seen(self, image_weight: float) -> list[Normal]:
        """Return the equations of all samples, then of all but those of each fold, with their images'.

        Those of the last weight are kept alone: a matrix of four chambers at degree 8 has 0.3 GB.
        """
        if image_weight not in self._sums:
            self._sums.clear()
            whole = reduce(_joined, self._parts(image_weight))
            parts = islice(self._parts(image_weight), self._settings.folds)
            self._sums[image_weight] = [whole, *(Normal(whole.matrix - p.matrix, whole.right - p.right) for p in parts)]
        return self._sums[image_weight]

    def _parts(self, image_weight: float) -> Iterator[Normal]:
        """Yield the equations of each fold, then of the samples that no fit leaves out, with their images'."""
        if not (image_weight and self._images):
            yield from self._own
            return
        for own, images in zip(self._own, self._images, strict=True):
            yield Normal(*(a + image_weight * b for a, b in zip(own, images, strict=True)))

    def judged(self, image_weight: float, anchor_weight: float, degree: int, ridge: float) -> Choice:
        """Return a choice with its error over folds that its fits did not see, weighed by how far samples are trusted."""
        choice = Choice(image_weight, anchor_weight, degree, ridge, np.nan)
        farthest = LOST**2 * float((self._samples.coordinate[:, -3:] ** 2).sum(axis=1).mean())
        squares = 0.0
        for part in range(self._settings.folds):
            model = replace(self._draft, energy=self.energy(choice, part))
            here = self._fold == part
            errors = squared_tip_errors(model, self._samples.rows(here))
            squares += float(self._trusted[here] @ np.minimum(errors, farthest))
        return choice._replace(tip_error_m=float(np.sqrt(squares / self._trusted[self._fold != ALWAYS].sum())))

    def model(self, choice: Choice) -> ReducedModel:
        """Return the reduced model with the energy ``choice``."""
        return replace(
            self._draft, energy=self.energy(choice), symmetry="all" if choice.image_weight else "none"
        )


def _joined(one: Normal, other: Normal) -> Normal:
    """Return the equations of both."""
    return Normal(one.matrix + other.matrix, one.right + other.right)


def tried(settings: FitSettings, candidates: Candidates) -> list[Choice]:
    """Return the candidates without anchors, the best first, see ``best_first``.

    First all weights of images and degrees at the middle ridge are tried, then the other ridges at the best weight, near
    its degree, or at all degrees where that ridge is too much or too little for any to be stable at rest.
    """
    ridges = sorted(settings.ridges)
    middle = ridges.pop(len(ridges) // 2)
    degrees = range(2, settings.energy_degree_max + 1)
    choices = [candidates.judged(weight, 0.0, degree, middle) for weight in candidates.image_weights for degree in degrees]
    best = best_first(choices)[0]
    lost = not stands(candidates.model(best))
    near = [degree for degree in degrees if lost or abs(degree - best.degree) <= 1]
    choices += [candidates.judged(best.image_weight, 0.0, degree, ridge) for degree in near for ridge in ridges]
    return best_first(choices)


def best_first(choices: list[Choice]) -> list[Choice]:
    """Return ``choices`` by rising error of the tip in cross-validation, but first good ones with the images to trust."""
    by_error = sorted(choices, key=lambda choice: choice.tip_error_m)
    least: dict[float, float] = {}
    for choice in by_error:
        least.setdefault(choice.image_weight, choice.tip_error_m)
    trusted, good = weight_to_trust(least), ALIKE * by_error[0].tip_error_m
    return sorted(by_error, key=lambda choice: choice.image_weight != trusted or choice.tip_error_m > good)


def anchored(settings: FitSettings, candidates: Candidates, trusted: Choice) -> list[Choice]:
    """Return the candidates of higher degree than ``trusted``, held to it."""
    degrees = range(trusted.degree + 1, settings.energy_degree_max + 1)
    weights = [weight for weight in settings.anchor_weights if weight > 0.0]
    return [
        candidates.judged(image, anchor, degree, min(settings.ridges))
        for image in candidates.image_weights for degree in degrees for anchor in weights
    ]  # fmt: skip


def first_that_settles(
    candidates: Candidates, choices: list[Choice], loads: np.ndarray, thrown: bool = True
) -> Choice | None:
    """Return the best of ``choices`` whose body is at rest only where it should be, or None; see ``settles``.

    A polynomial may have further wells beyond the samples. Statics from rest does not find them; a motion falls in.
    """
    return next((choice for choice in choices if settles(candidates.model(choice), loads, thrown)), None)


def safest(candidates: Candidates, choices: list[Choice]) -> Choice | None:
    """Return, where none settles, the candidate of lowest degree above 2 and of most ridge that is stable at rest."""
    tame = sorted(choices, key=lambda choice: (choice.degree < 3, choice.degree, -choice.ridge, choice.tip_error_m))
    return next((choice for choice in tame if stands(candidates.model(choice))), None)


def squared_tip_errors(model: ReducedModel, samples: Equilibria) -> np.ndarray:
    """Return the squared tip errors (S,) m^2; an equilibrium that is not found counts as the whole motion."""
    n = model.chambers
    if not stands(model):
        return np.full(len(samples.load), np.inf)
    points, failed = static_points(tables_of(model, np.zeros(3)), samples.load)
    errors = (((points @ model.frame.T) - samples.coordinate)[:, n:] ** 2).sum(axis=1)
    return np.where(failed, np.maximum(errors, (samples.coordinate[:, n:] ** 2).sum(axis=1)), errors)
