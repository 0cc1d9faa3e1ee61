"""How long a search may take is told before it begins."""

import time
from typing import Any

import pytest

from softrl.core.errors import SolverError
from softrl.diagnosis.checks.cost import REPLAYS, expected_s, warn_of_cost
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import made, node

NUMERICS = Numerics(0.02, 0.04, 0.1, 20.0, 4.0)


class Slow(PccSimulator):
    """A body that takes as long to simulate as it takes to move."""

    def simulate(self, times: Any, *others: Any, **named: Any) -> Any:
        time.sleep(float(times[-1] - times[0]))
        return super().simulate(times, *others, **named)


def test_a_simulator_that_is_too_slow_for_a_search_is_told_of(body: PccSimulator, caplog: pytest.LogCaptureFixture) -> None:
    runs = made(body, sessions=3).recordings
    slow = Problem(body.robot, Slow(body.robot, **node("simulator/pcc.yaml")), runs, NUMERICS, "motion", "command", False, False)
    seconds = sum(float(run.time[-1] - run.time[0]) for run in runs)
    assert expected_s(slow, 2) == pytest.approx(REPLAYS * seconds / 2, rel=0.5)
    warn_of_cost(slow, 2)
    assert "hours or more" in caplog.text and "Slow" in caplog.text


def test_a_body_that_does_not_bear_to_be_timed_is_not_told_of(body: PccSimulator, caplog: pytest.LogCaptureFixture) -> None:
    class Breaks(PccSimulator):
        def simulate(self, *others: Any, **named: Any) -> Any:
            raise SolverError("too sudden")

    runs = made(body, sessions=1).recordings
    breaks = Breaks(body.robot, **node("simulator/pcc.yaml"))
    frail = Problem(body.robot, breaks, runs, NUMERICS, "motion", "command", False, False)
    warn_of_cost(frail, 2)
    assert expected_s(frail, 2) == 0.0 and not caplog.records
