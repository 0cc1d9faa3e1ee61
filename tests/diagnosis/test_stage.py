"""Truth told on recordings with known physics: what is there is named, what is not is not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.errors import ConfigError, RecordingError
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import hold_out
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured, made

FEW = ["lag", "viscoelasticity", "hysteresis", "payload"]


class Pages(NullTracker):
    """Keeps texts."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: dict[str, str] = {}

    def text(self, name: str, content: str) -> None:
        self.texts[name] = content


def physics(name: str, **values: float) -> Effect:
    return effect_class(name)(**values)


LAG = physics("lag", fill_s=0.12, vent_s=0.20)
CREEP = physics("viscoelasticity", share_1=0.3, relaxation_1_s=1.5, share_2=0.0, relaxation_2_s=20.0)


def other(body: PccSimulator) -> PccSimulator:
    return body.with_parameters(bending_stiffness_scale=0.95, damping_s=0.06, mass_scale=1.04)


def diagnose(body: PccSimulator, recordings: RecordingSet, **overrides: Any) -> tuple[Diagnosis, Pages]:
    tracker = Pages()
    found = run(configured(**overrides), body.robot, recordings, body, tracker=tracker)
    found.validate()
    return found, tracker


@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_missing_when_only_parameters_differ(body: PccSimulator, seed: int) -> None:
    stiffer = body.with_parameters(bending_stiffness_scale=1.3, axial_stiffness_scale=0.8)
    found, _ = diagnose(body, made(stiffer, seed=seed))
    assert found.verdict == "nothing missing", found.sentences
    assert found.effects == []
    assert found.simulator_parameters["bending_stiffness_scale"] == pytest.approx(1.3, rel=0.02)
    held = found.errors_mm["heldout"]
    assert held["corrected"] < 0.05 * held["nominal"]


def test_lag_is_named_at_the_valve_from_measured_pressure(body: PccSimulator, tmp_path: Path) -> None:
    found, tracker = diagnose(body, made(other(body), (LAG,), measured=True), candidates=FEW)
    assert found.verdict == "named"
    (effect,) = found.effects
    assert (effect["name"], effect["site"]) == ("lag", "valve")
    for name, truth in (("fill_s", 0.12), ("vent_s", 0.20)):
        entry = effect["parameters"][name]
        assert entry["low"] <= truth <= entry["high"], entry
        assert entry["high"] - entry["low"] < 0.1 * truth
    held = found.errors_mm["heldout"]
    assert held["corrected"] < 0.2 * held["retuned"] < held["nominal"]
    json.dumps(found.document())
    found.save(tmp_path / "diagnosis")
    assert Diagnosis.load(tmp_path / "diagnosis").corrections() == found.corrections()
    assert "data:image/png" in tracker.texts["report.html"] and "http" not in tracker.texts["report.html"]
    assert tracker.metrics["heldout/corrected_error_mm"] == held["corrected"]
    assert held["corrected"] < 0.34 * held["static"] and held["corrected"] < held["blackbox"]


def test_equal_seeds_give_equal_diagnoses(body: PccSimulator) -> None:
    recordings = made(other(body), (LAG,), sessions=3)
    few = {"candidates": ["lag", "payload"], "search": {"starts": 1}}
    assert diagnose(body, recordings, **few)[0] == diagnose(body, recordings, **few)[0]


def test_no_chamber_moves_means_cannot_tell(body: PccSimulator) -> None:
    still = made(body, sessions=2)
    runs = tuple(replace(r, pressure_cmd=0.0 * r.pressure_cmd) for r in still.recordings)
    found, _ = diagnose(body, replace(still, recordings=runs))
    assert found.verdict == "unknown" and "no chamber" in found.sentences[0]
    promised = {"verdict", "effects", "rivals", "located", "errors_mm", "unexplained", "next_experiment"}
    assert promised <= set(found.document())


def test_heldout_runs_share_nothing_with_training(body: PccSimulator) -> None:
    recordings = made(body, sessions=5)
    training, heldout = hold_out(recordings, 0.34, 0)
    names = [{r.session for r in side.recordings} for side in (training, heldout)]
    assert not names[0] & names[1] and len(names[0] | names[1]) == 5


def test_another_robot_is_refused(body: PccSimulator) -> None:
    with pytest.raises(RecordingError, match="robot=finger"):
        diagnose(body, RecordingSet(robot_name="finger", recordings=()))


def test_unknown_candidate_is_refused() -> None:
    with pytest.raises(ConfigError, match="magic"):
        configured(candidates=["magic"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "parameter", "value"),
    [
        (LAG, "fill_s", 0.12),
        (CREEP, "relaxation_1_s", 1.5),
        (physics("hysteresis", height=0.06, yield_strain=0.02), "height", 0.06),
        (physics("leak", leak_per_s=0.3, refill_s=3.0), "leak_per_s", 0.3),
    ],
    ids=lambda v: v.name() if isinstance(v, Effect) else None,
)
def test_single_effect_is_named_out_of_the_whole_library(
    body: PccSimulator, truth: Effect, parameter: str, value: float
) -> None:
    found, _ = diagnose(body, made(other(body), (truth,), seed=3))
    assert found.verdict in ("named", "indistinguishable"), found.sentences
    assert [effect["name"] for effect in found.effects] == [truth.name()]
    entry = found.effects[0]["parameters"][parameter]
    assert entry["low"] <= value <= entry["high"], entry


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("mass", [0.2, 0.6])
def test_payload_is_named_and_not_an_offset(body: PccSimulator, mass: float, seed: int) -> None:
    found, _ = diagnose(body, made(other(body), (physics("payload", mass=mass),), seed=seed))
    assert found.verdict == "named", found.sentences
    assert [effect["name"] for effect in found.effects] == ["payload"]
    assert found.effects[0]["parameters"]["mass"]["value"] == pytest.approx(mass, rel=0.05)
    assert found.next_experiment is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6])
def test_noise_with_a_memory_is_neither_named_nor_unknown(body: PccSimulator, seed: int) -> None:
    def coloured(recording: Recording) -> Recording:
        assert recording.position is not None
        rng = np.random.default_rng(int(recording.name[-1]) + 100 * seed)
        noise = lfilter(
            [np.sqrt(1.0 - 0.96**2)], [1.0, -0.96], rng.standard_normal((len(recording.time) + 500, 3)), axis=0
        )
        return replace(recording, position=recording.position + 3e-4 * noise[500:])

    found, _ = diagnose(body, made(other(body), seed=seed, process=coloured))
    assert found.verdict == "nothing missing", found.sentences


@pytest.mark.slow
def test_a_branch_that_is_not_there_is_not_reported(body: PccSimulator) -> None:
    found, _ = diagnose(body, made(other(body), (CREEP,), seed=1), candidates=FEW)
    (effect,) = found.effects
    assert set(effect["parameters"]) == {"share_1", "relaxation_1_s"}
    assert effect["pinned"]["share_2"] == 0.0
    assert found.corrections()[0]["parameters"].keys() == {f.name for f in CREEP.parameter_fields()}


@pytest.mark.slow
def test_pair_is_named_at_two_sites(body: PccSimulator) -> None:
    found, _ = diagnose(body, made(other(body), (LAG, CREEP), seed=2, measured=True))
    assert {(e["name"], e["site"]) for e in found.effects} == {("lag", "valve"), ("viscoelasticity", "body")}


@pytest.mark.slow
def test_physics_outside_the_candidates_is_unknown_not_a_false_name(body: PccSimulator) -> None:
    def swaying(recording: Recording) -> Recording:
        assert recording.position is not None
        sway = 6e-3 * np.sin(2.0 * np.pi * 0.23 * recording.time)
        return replace(recording, position=recording.position + np.outer(sway, [0.6, 0.8, 0.0]))

    found, _ = diagnose(body, made(other(body), seed=4, process=swaying))
    assert found.verdict == "unknown", found.sentences
    assert found.next_experiment is not None
