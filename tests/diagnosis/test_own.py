"""Which sessions, held out whole, differ from the others in themselves."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.problem import Residual
from softrl.diagnosis.judging.own import differing

ROWS = 50


def finding(base_m: float, best_m: float, apart_m: float, named: bool) -> Any:
    """Return what is left of a search: on fitted runs without and with its best effect, and with it on another session."""

    def trial(left_m: float, beside_m: float) -> Any:
        placed = np.full((ROWS, 1), beside_m)
        return SimpleNamespace(inside=np.full(ROWS, left_m**2), hypothesis=None, fit=SimpleNamespace(point=placed), placed={})

    problem = SimpleNamespace(
        runs=[SimpleNamespace(session="c")], residual=lambda _, point, __: Residual([point], {})
    )
    judge = SimpleNamespace(problem=problem, material=1e-4, excess=np.sqrt)
    best = trial(best_m, apart_m)
    return SimpleNamespace(
        part=SimpleNamespace(problem=SimpleNamespace(runs=[SimpleNamespace(session=s) for s in "aabb"])),
        judge=judge,
        named=[best] if named else [],
        final=best if named else trial(base_m, apart_m),
        path=SimpleNamespace(best=best),
    )


@pytest.mark.parametrize(
    ("base_m", "best_m", "apart_m", "named", "differs"),
    [
        (2.5e-3, 1.3e-3, 3.0e-3, False, True),  # what describes the fitted runs does not hold on the other session
        (2.5e-3, 2.4e-3, 3.0e-3, False, False),
        (2.5e-3, 1.3e-3, 3.0e-3, True, True),
        (2.5e-3, 1.3e-3, 2.0e-3, True, False),
    ],
)
def test_a_session_is_judged_by_what_describes_the_others_best(
    base_m: float, best_m: float, apart_m: float, named: bool, differs: bool
) -> None:
    runs: Any = [SimpleNamespace(session=session) for session in "aaabbbccc"]
    assert bool(differing(finding(base_m, best_m, apart_m, named), runs)) is differs


def test_a_session_of_two_runs_is_not_both_fitted_and_judged() -> None:
    runs: Any = [SimpleNamespace(session=session) for session in "aaabbbc"]
    assert not differing(finding(2.5e-3, 1.3e-3, 9e-3, True), runs)
