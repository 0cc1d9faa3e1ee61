"""A rival of what is named, and which of several takes its place."""

from collections.abc import Sequence
from typing import NamedTuple

from softrl.diagnosis.fitting.hypothesis import Choice, build_effect
from softrl.diagnosis.fitting.judge import ABRUPT_S, Gap, Judge, takes_s, too_sudden
from softrl.diagnosis.fitting.trial import Trial, axes_of
from softrl.effects.library import effect_class


class Rival(NamedTuple):
    """An alternative to a named effect: how much worse it is held out, and whether the data can tell; its fit.

    ``better`` says that it is better for sure, held out and on all runs that its fits did not see, see ``overtakes``.
    """

    instead_of: Choice
    choice: Choice
    gap: Gap
    equivalent: bool
    trial: Trial
    better: bool

    @property
    def contests(self) -> bool:
        """Whether it does as well and says something else: another effect, or the same one of another chamber.

        A law that contains what is named cannot do worse, and says no more where it does no better. Nor does one which is that
        where it begins in a moment, or with the numbers that it was fitted with.
        """
        mine, named = self.choice, self.instead_of
        if not self.equivalent or of_another_chamber(mine, named):
            return self.equivalent
        later = effect_class(named.name).onset_of == mine.name and mine.chamber == named.chamber
        same = later and takes_s(self.trial, mine) < ABRUPT_S
        axes = axes_of(self.trial, mine).values()
        fitted = build_effect(mine, [axis.physical(float(self.trial.fit.point[column])) for axis, column in axes])
        return named.name not in (mine.name, *effect_class(mine.name).contains, fitted.told_as) and not same


def of_another_chamber(one: Choice, other: Choice) -> bool:
    """Return whether both are the same effect, of two chambers."""
    return one.name == other.name and min(one.chamber, other.chamber) >= 0 and one.chamber != other.chamber


def stand_in(judge: Judge, without: Trial, rivals: Sequence[Rival]) -> Rival | None:
    """Return the best of ``rivals`` that pay held out beside what ``without`` has, if any does."""
    paying = [rival for rival in rivals if judge.pays(without.squares, rival.trial.squares)]
    return min(paying, key=lambda rival: rival.gap.value, default=None)


def overtaking(rivals: Sequence[Rival]) -> Rival | None:
    """Return the best of the rivals that are better for sure, held out."""
    return min((rival for rival in rivals if rival.better), key=lambda rival: rival.gap.value, default=None)


def plainer(judge: Judge, rivals: Sequence[Rival], final: Trial) -> Rival | None:
    """Return the one of ``rivals`` whose law what is named extends, or contains, and betters by less than counts, if any.

    A ceiling that yields by a hundredth is a ceiling, and a flow that is hardly ever bounded a lag; but a law that needs more
    numbers for it is no plainer.
    """
    most = len(final.fit.point)
    plain = [rival for rival in rivals if _within(rival) and len(rival.trial.fit.point) <= most]
    return next((r for r in plain if judge.removed(r.trial.squares, final.squares) < judge.material), None)


def suddenly(rivals: Sequence[Rival], final: Trial) -> Rival | None:
    """Return the best of ``rivals`` that do as well as an effect of ``final`` which began suddenly and is none that does.

    A mount does not lean over in a moment; a camera is knocked.
    """
    strange = too_sudden(final)
    ready = [r for r in rivals if r.instead_of in strange and r.equivalent and not too_sudden(r.trial)]
    return min(ready, key=lambda rival: rival.gap.value, default=None)


def simpler(rivals: Sequence[Rival], final: Trial, redated: Sequence[Choice]) -> Rival | None:
    """Return the best of ``rivals`` that do as well as one of the effects ``redated``, with fewer numbers.

    Fits took it for what acts in some sessions, which needs the fewest numbers. Since a held-out run showed that it began in
    the middle of a session it has as many as others which begin at a moment.
    """
    most = len(final.fit.point)
    ready = [r for r in rivals if r.instead_of in redated and r.equivalent and len(r.trial.fit.point) < most]
    return min(ready, key=lambda rival: rival.gap.value, default=None)


def _within(rival: Rival) -> bool:
    """Return whether the effect whose place ``rival`` would take extends or contains its law, where it acts."""
    named, other = rival.instead_of, rival.choice
    return other.name in (effect_class(named.name).extends, *effect_class(named.name).contains) and named.chamber == other.chamber
