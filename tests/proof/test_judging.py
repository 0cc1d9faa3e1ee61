"""A control's residual keeps size and colour, and neither lines nor jumps; the key means what the library means."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.proof import judging
from softrl.proof.generator.catalogue import draw
from softrl.proof.generator.plan import Case
from softrl.proof.judging import plain, redrawn
from softrl.proof.trial import _entry
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from softrl.robots.robot import Robot


def test_a_control_keeps_size_and_colour_but_no_line() -> None:
    rng, time = np.random.default_rng(0), 0.02 * np.arange(1500)
    slow = 0.02 * np.cumsum(rng.standard_normal((1500, 3)), axis=0)
    made = redrawn(slow + np.sin(2.0 * np.pi * time)[:, None], rng)
    np.testing.assert_allclose(made.std(axis=0), (slow + np.sin(2.0 * np.pi * time)[:, None]).std(axis=0))
    power = np.abs(np.fft.rfft(made, axis=0)) ** 2
    assert power[:20].sum() > 3.0 * power[300:].sum(), "slow as before"
    share = power[30] / power[24:37].sum(axis=0)
    assert share.max() < 0.6, "the swing of 1 Hz is spread over its neighbours"


def test_controls_of_a_proof_are_drawn_apart_and_each_again_alike(
    tmp_path: Path, tripod: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of equal recordings two cases would else be one control: what is drawn depends on the case, too."""
    time, noise = 0.02 * np.arange(1, 800), np.random.default_rng(5).standard_normal((799, 3))
    tip = np.array([0.0, 0.0, tripod.length_m]) + 1e-4 * np.cumsum(noise, axis=0)
    for name in ("0a1b", "7f3c"):
        write(tmp_path / name, RecordingSet("tripod", (Recording("run", "s", time, np.zeros((799, 3)), position=tip),)))
    still = SimpleNamespace(position=np.tile([0.0, 0.0, tripod.length_m], (799, 1)))
    monkeypatch.setattr(judging, "built", lambda *_: None)
    monkeypatch.setattr(judging, "replay", lambda *_: still)
    given = {"retuned_late_s": 0.0, "retuned": {}}

    def phases(name: str, seed: int) -> np.ndarray:
        made = judging.without_relation(tmp_path / name, given, tripod, None, 0.01, seed).recordings[0]
        lines = np.fft.rfft(made.position - still.position, axis=0)[1:300]
        return lines / abs(lines)

    def alike(*ones: np.ndarray) -> float:
        return float(np.mean((ones[0] * ones[1].conj()).real))

    one = phases("0a1b", 39)
    assert alike(one, phases("0a1b", 39)) > 0.999
    assert abs(alike(one, phases("7f3c", 39))) < 0.2 and abs(alike(one, phases("0a1b", 40))) < 0.2


@pytest.mark.parametrize("mass", [1.0, 1.05])
def test_a_hidden_payload_counts_in_masses_of_the_robot_as_described(mass: float) -> None:
    law = draw("mass", "everywhere", 30.0, 3, np.random.default_rng(0))
    entry = _entry(law, 0.4, Case(0, "single", (("mass", "everywhere"),), 5.0, False, 0), 5.0, mass)
    assert entry["parameters"]["payload.mass"] == pytest.approx(0.4 * mass)


def test_an_answer_keeps_what_was_told_as_neutral() -> None:
    turn = {"value": 0.02, "low": 0.01, "high": 0.03, "unit": "rad", "at_bound": False}
    told = {"name": "frame", "site": "sensor", "chamber": -1, "parameters": {"turn_z_rad": turn}, "pinned": {"shift_x": 0.0},
            "pinned_intervals": {"shift_x": {"low": -0.1, "high": 0.2, "unit": "1"}}}  # fmt: skip
    found = Diagnosis("tripod", "PccSimulator", "named", [], [told | {"evidence": "much"}], {}, {}, [], [], {}, {}, {}, None, {})
    assert plain(found)["effects"] == [told]


def test_the_retuned_body_is_as_long_as_it_was_taken_to_be() -> None:
    """It is not retuned, and without it retuning alone would be judged as a body that nobody fitted."""
    body = {"bending_stiffness_scale": 1.1, "length_scale": 1.03}
    retuned = {"bending_stiffness_scale": {"nominal": 1.0, "value": 1.2, "lowest": 0.25, "highest": 4.0, "plausible": True}}
    found = Diagnosis("tripod", "PccSimulator", "nothing missing", [], [], body, retuned, [], [], {}, {}, {}, None, {})
    assert plain(found)["retuned"] == {"bending_stiffness_scale": 1.2, "length_scale": 1.03}
