"""When a rival does as well as what was found, when it takes its place, and what is asked again once it has."""

from collections.abc import Sequence

from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial
from softrl.diagnosis.judging.dated import Dating
from softrl.diagnosis.search.moves import swap
from softrl.diagnosis.search.path import Path
from softrl.effects.library import effect_class


def as_good(judge: Judge, both: Judge, rival: Trial, final: Trial) -> bool:
    """Return whether ``rival`` does as well as ``final``: it may be better held out, or all runs left out cannot tell.

    A rival that may be better, and is worse by what nobody would notice, is as good: where a body is not quite the robot's, all
    runs together tell apart what no run to come does.
    """
    unnoticed = judge.removed(rival.squares, final.squares) < judge.material
    if unnoticed and judge.gap(rival.squares, final.squares).low <= 0.0:
        return True
    return not both.tells(rival.everywhere, final.everywhere)


def overtakes(judge: Judge, both: Judge, rival: Trial, final: Trial) -> bool:
    """Return whether ``rival`` is better than ``final`` for sure on held-out runs, and on all runs left out of fits.

    The few held-out runs alone are easily in favour of either of two that are nearly alike. A map without physics bends to
    anything, and so does a law with more numbers: what they remove beyond the other has to be as large as what counts.
    """
    if judge.gap(final.squares, rival.squares).low <= 0.0 or both.gap(final.everywhere, rival.everywhere).low <= 0.0:
        return False
    freer = len(rival.fit.point) > len(final.fit.point) or effect_class(rival.hypothesis.effects[-1].name).together
    return not freer or judge.stands_out(final.squares, rival.squares)


def asked_again(
    fitting: Problem, inside: Judge, judge: Judge, final: Trial, choices: Sequence[Choice], search: Search, path: Path
) -> Trial:
    """Return ``final`` with each effect but the last put to the test against all others in its place, by the runs of the fits.

    Beside an effect that has taken another's place the others may be others. ``inside`` judges on the runs of the fits,
    ``judge`` on those held out: what predicts these worse is left as it was.
    """
    trial = swap(fitting, inside, final._replace(squares=final.inside), choices, search, path)
    if trial.hypothesis == final.hypothesis:
        return final
    dating = Dating(fitting, judge)
    found = [dating.of(one) for one in dating.that_run([trial])]
    return found[0] if found and not judge.tells(found[0].squares, final.squares) else final
