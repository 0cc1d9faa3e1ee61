"""What the console is spared: warnings that are alike, and no others."""

import logging

import pytest

from softrl.core.progress import TqdmHandler


def test_sentences_are_alike_by_what_they_say_and_not_by_how_they_are_logged(capsys: pytest.CaptureFixture[str]) -> None:
    handler = TqdmHandler()
    still = [f"run_{k}: chamber {k} is not driven" for k in range(1, 9)]
    odd = ["run_1: position[0] is at its maximum 0.2 in 31% of the samples: clipped?", "run_7: 3 gaps in the samples"]
    for line in (*still, *odd):
        handler.emit(logging.LogRecord("softrl.simulate.stage", logging.WARNING, "", 0, "%s", (line,), None))
    for k in range(8):
        handler.emit(logging.LogRecord("softrl.fem", logging.WARNING, "", 0, "load %d: no equilibrium", (k,), None))
    told = capsys.readouterr().err.splitlines()
    further = " (further warnings of this kind: softrl.log)"
    loads = [f"load {k}: no equilibrium" for k in range(3)]
    assert told == [*still[:2], still[2] + further, *odd, *loads[:2], loads[2] + further]
