"""The refit from the command may not unlearn what the measured pressure has shown of the body."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.judging.join import _spoilt
from softrl.diagnosis.stage import run
from softrl.effects.strain_softening import StrainSoftening
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made


class Bowl:
    """Errs by ``noise``, and by its distance from the point at which it lies, m."""

    def __init__(self, noise: float) -> None:
        self.noise = noise

    def residual(self, _: Any, point: np.ndarray) -> Any:
        return SimpleNamespace(squares=np.full(4, self.noise**2 + float(point @ point)))


@pytest.mark.parametrize(
    ("noise", "moved", "helped", "spoilt"),
    [(1.0, 0.5, 1.0, False), (1.0, 2.0, 1.5, True), (1.0, 2.0, 3.0, False), (0.01, 0.1, 1.5, False)],
)
def test_a_point_is_spoilt_where_the_body_errs_more_than_it_helps(
    noise: float, moved: float, helped: float, spoilt: bool
) -> None:
    judge = SimpleNamespace(rms=lambda squares: float(np.sqrt(np.mean(squares))), material=0.2)
    final = SimpleNamespace(hypothesis=None, fit=SimpleNamespace(point=np.zeros(1)))
    motion: Any = SimpleNamespace(final=final, part=SimpleNamespace(problem=Bowl(noise)), judge=judge)
    assert _spoilt(motion, np.array([moved]), helped) is spoilt


@pytest.mark.slow
def test_behind_a_valve_that_is_not_understood_the_body_stays_as_its_gauge_shows_it(body: PccSimulator) -> None:
    """Pressures come a second after their commands, which nothing that is asked describes: a wall that made up for it is none."""

    def late(run: Recording) -> Recording:
        return replace(run, pressure_cmd=np.roll(run.pressure_cmd, -50, axis=0))

    hidden = StrainSoftening(3.0, 0.2)
    recordings = made(body, (hidden,), sessions=4, measured=True, process=late)
    found = run(configured(candidates=["strain_softening"]), body.robot, recordings, body, tracker=NullTracker())
    assert found.verdict == "unknown" and [effect["name"] for effect in found.effects] == ["strain_softening"], found.sentences
    told = {name: part["value"] for name, part in found.effects[0]["parameters"].items()}
    assert told == pytest.approx({"softness": hidden.softness, "residual": hidden.residual}, rel=0.05)
