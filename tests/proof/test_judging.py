"""A control's residual keeps size and colour, and neither lines nor jumps; the key means what the library means."""

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.proof.generator.catalogue import draw
from softrl.proof.generator.plan import Case
from softrl.proof.judging import plain, redrawn
from softrl.proof.trial import _entry


def test_a_control_keeps_size_and_colour_but_no_line() -> None:
    rng, time = np.random.default_rng(0), 0.02 * np.arange(1500)
    slow = 0.02 * np.cumsum(rng.standard_normal((1500, 3)), axis=0)
    made = redrawn(slow + np.sin(2.0 * np.pi * time)[:, None], rng)
    np.testing.assert_allclose(made.std(axis=0), (slow + np.sin(2.0 * np.pi * time)[:, None]).std(axis=0))
    power = np.abs(np.fft.rfft(made, axis=0)) ** 2
    assert power[:20].sum() > 3.0 * power[300:].sum(), "slow as before"
    share = power[30] / power[24:37].sum(axis=0)
    assert share.max() < 0.6, "the swing of 1 Hz is spread over its neighbours"


@pytest.mark.parametrize("mass", [1.0, 1.05])
def test_a_hidden_payload_counts_in_masses_of_the_robot_as_described(mass: float) -> None:
    law = draw("mass", "everywhere", 30.0, 3, np.random.default_rng(0))
    entry = _entry(law, 0.4, Case(0, "single", (("mass", "everywhere"),), 5.0, False, 0), 5.0, mass)
    assert entry["parameters"]["payload.mass"] == pytest.approx(0.4 * mass)


def test_an_answer_keeps_what_was_told_as_neutral() -> None:
    turn = {"value": 0.02, "low": 0.01, "high": 0.03, "unit": "rad", "at_bound": False}
    told = {"name": "frame", "site": "sensor", "chamber": -1, "parameters": {"turn_z_rad": turn}, "pinned": {"shift_x": 0.0}}
    found = Diagnosis("tripod", "PccSimulator", "named", [], [told | {"evidence": "much"}], {}, {}, [], [], {}, {}, {}, None, {})
    assert plain(found)["effects"] == [told]
