"""Sessions that were held out whole and differ from the others in themselves: what acts in one alone no other can show."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.checks.data import ENOUGH_RUNS
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.leftover import heldout_residual
from softrl.recordings.recording import Recording

APART = 2.0  # times what is left on the fitted runs, each left out in turn


def differing(finding: Finding, runs: Sequence[Recording]) -> list[str]:
    """Return the sessions held out whole on which plainly more is left than on the runs of the fits.

    By what describes these best, though it may not have held on the others. None where a session of ``runs`` has too few of
    them to be both fitted and judged.
    """
    count = [sum(run.session == session for run in runs) for session in {run.session for run in runs}]
    if min(count) < ENOUGH_RUNS:
        return []
    judge, fitted = finding.judge, {run.session for run in finding.part.problem.runs}
    best = finding.final if finding.named else finding.path.best
    left = heldout_residual(judge, best)
    squares = np.split(left.squares, np.cumsum([len(rows) for rows in left.runs])[:-1])
    usual = max(float(judge.excess(best.inside.mean())), judge.material)
    found = []
    for session in dict.fromkeys(run.session for run in judge.problem.runs if run.session not in fitted):
        mine = [s for run, s in zip(judge.problem.runs, squares, strict=True) if run.session == session]
        if judge.excess(np.concatenate(mine).mean()) > APART * usual:
            found.append(session)
    return found


def told_of(sessions: Sequence[str]) -> str:
    """Return in a sentence why some runs of ``sessions`` were given to fits."""
    return (
        f"Session {', '.join(sessions)}, held out whole, differed from the others in itself: whole runs of every session were "
        "held out instead, so what is said of that session was judged on runs of the same day."
    )
