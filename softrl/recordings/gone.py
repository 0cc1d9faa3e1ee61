"""How long a robot had been at work when a run began: what lasts goes on from run to run."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

from softrl.recordings.run import Recording


class Now(NamedTuple):
    """Where recording has come to: the session of the last run, and ``gone_s`` of a run that followed it at once."""

    session: str
    gone_s: tuple[float, float, float]


def now_after(runs: Iterable[Recording]) -> Now:
    """Return where ``runs``, out of ``in_order`` and whole, have come to."""
    last = max(runs, key=lambda run: run.gone_s[-1])
    lasted = float(last.time[-1] - last.time[0])
    return Now(last.session, (0.0, last.gone_s[1] + lasted, last.gone_s[2] + lasted))


def sessions_in_order(runs: Iterable[Recording]) -> list[str]:
    """Return the sessions of ``runs``, out of ``in_order``, as they were recorded one after another."""
    return list(dict.fromkeys(run.session for run in sorted(runs, key=lambda run: run.gone_s[-1])))


def in_order(runs: Iterable[Recording]) -> tuple[Recording, ...]:
    """Return ``runs``, which stand in the order of recording, each with how long its session and all had gone on before.

    Where the times of a run go on from those of the run before, in its session, a pause between them counts; else each
    begins where the last one ended. What lies between two sessions is not known, and counts as nothing.
    """
    found, session, first, session_s, ever_s = [], None, 0.0, 0.0, 0.0
    for run in runs:
        if run.session != session:
            session, first, ever_s, session_s = run.session, float(run.time[0]), ever_s + session_s, 0.0
        begins = max(session_s, float(run.time[0]) - first)
        found.append(replace(run, gone_s=(0.0, begins, ever_s + begins)))
        session_s = begins + float(run.time[-1] - run.time[0])
    return tuple(found)
