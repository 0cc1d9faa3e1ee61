"""The keys at the root: what is out of range or unknown is refused in one line; policies are found by their task."""

import importlib
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hydra
import pytest
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from softrl import pipeline
from softrl.artifacts.diagnosis import Diagnosis
from softrl.artifacts.policy import Policy
from softrl.assembly import NOMINAL, Assembly, _corrected_by
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.simulator import Simulator
from softrl.core.store import Store
from softrl.effects.chain import EffectChain
from softrl.loop import _compose
from softrl.pipeline import EXTRA, STAGES, _copy, _own_folder, _Prepared, _whole, run_stage

CONF = Path(__file__).resolve().parents[2] / "conf"


def composed(*words: str) -> dict:
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        return _compose(list(words))


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("alpha=2", "alpha=2 is refused; expected a share between 0 and 1"),
        ("alpha=-0.1", "alpha=-0.1"),
        ("alpha=true", "alpha=True"),
        ("lambda=nan", "lambda=nan is refused; expected a number from 0 on"),
        ("lambda=inf", "lambda=inf"),
        ("seed=1.5", "seed=1.5 is refused; expected a whole number"),
        ("seed=4294967296", "seed=4294967296"),
        ("force=1", "force=1 is refused; expected true or false"),
        ("recordings=7", "recordings=7 is refused; expected a folder"),
        ("+sed=3", "sed=3 is an unknown key"),
        ("+inputs.mehs=latest", r"inputs.mehs=latest is an unknown key; .*snapshots \(of stage=fem\)"),
        ("inputs.mesh=somewhere", "expected latest, run:<id> or path:<folder>"),
    ],
)
def test_a_wrong_key_at_the_root_is_refused(word: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        composed("stage=mesh", word)


def test_the_latest_policy_is_that_of_the_task() -> None:
    asked: list[dict[str, str]] = []

    def find(tags: dict[str, str]) -> object:
        asked.append(tags)
        return None if tags.get("task") == "force" else SimpleNamespace()

    assembly = Assembly(SimpleNamespace(find=find), composed("stage=sim2real", "task=force"), {})
    with pytest.raises(ArtifactError, match=r"there is one with another task; run stage=rl task=force"):
        assembly._locate(Policy, "policy")
    assert asked[0]["task"] == "force"


def test_the_latest_diagnosis_is_found_where_its_effects_are_asked_for() -> None:
    found = SimpleNamespace(info=SimpleNamespace(run_id="7"), data=SimpleNamespace(tags={}))
    store = SimpleNamespace(find=lambda tags: found, folder=lambda run, name: Path(name))
    assembly = Assembly(store, composed("stage=rl", "effect=identified"), {})
    assert assembly.latest(Diagnosis) is found
    assert assembly.latest(Policy) is found, "the mark of its effects asks for the diagnosis"


@pytest.mark.parametrize(
    ("stage", "word"),
    [("excite", "stage.seed=-1"), ("diagnosis", "stage.seed=1.5"), ("proof", "stage.seed=4294967296"),
     ("proof", "stage.diagnosis.seed=-1")],
)
def test_a_seed_of_a_stage_is_refused_as_the_roots_is(stage: str, word: str) -> None:
    with pytest.raises(ConfigError, match=f"{word} is refused; expected a whole number from 0 to 4294967295"):
        composed(f"stage={stage}", word)
    assert composed(f"stage={stage}", "stage.seed=7")["stage"]["seed"] == 7


@pytest.mark.parametrize(
    ("stage", "taken", "made", "told"),
    [
        ("mesh", "later", None, "run later is newer, and what other stages take; give them inputs.mesh=run:before for"),
        ("mesh", "before", None, ""),
        ("calibration", "earlier", None, ""),  # one with effects, beside which the nominal one is taken
        ("mesh", "later", {}, ""),  # in a loop the run of each stage goes on
        ("proof", "later", None, ""),  # which no stage takes
    ],
)
def test_a_run_that_is_reused_tells_which_newer_one_is_taken(
    stage: str, taken: str, made: dict[str, str] | None, told: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    runs = {name: SimpleNamespace(info=SimpleNamespace(run_id=name, start_time=k))
            for k, name in enumerate(("earlier", "before", "later"))}  # fmt: skip
    store = SimpleNamespace(find=lambda tags: runs[taken], every=lambda tags: [runs[taken]])
    assembly = Assembly(store, composed(f"stage={stage}"), {})
    task = _Prepared(assembly.store, assembly, None, None, {}, "", runs["before"], None, None)
    monkeypatch.setattr(pipeline, "_prepare", lambda *_: task)
    monkeypatch.setattr(pipeline, "_reused", lambda *_: None)
    run_stage(stage, {}, tmp_path, made)
    assert told in caplog.text if told else "newer" not in caplog.text


@pytest.mark.parametrize(("left", "whole"), [(["mesh", "a", "result.json"], True), (["mesh"], False), (["result.json"], False)])
def test_a_run_is_reused_with_all_that_it_left(left: list[str], whole: bool) -> None:
    store, run = object.__new__(Store), SimpleNamespace(info=SimpleNamespace(run_id="before"))
    files = [SimpleNamespace(path=name) for name in left]
    store.client = SimpleNamespace(list_artifacts=lambda run_id: files)  # type: ignore[assignment]
    assert _whole(store, run, "mesh") is (run if whole else None) and _whole(store, None, "mesh") is None


def test_a_correction_of_another_body_is_refused() -> None:
    found = Diagnosis.__new__(Diagnosis)
    object.__setattr__(found, "simulator_name", "PccSimulator")
    object.__setattr__(found, "simulator_parameters", {"axial_stiffness_scale": 1.2})
    assembly = Assembly(SimpleNamespace(), composed("stage=simulate", "simulator=rom"), {})
    assembly._artifact = lambda kind: found
    rom: Any = SimpleNamespace(parameters={"damping_scale": 1.0})
    with pytest.raises(ArtifactError, match="made with PccSimulator and gives its axial_stiffness_scale, which SimpleNamespace"):
        assembly._corrected(rom)


def test_what_a_diagnosis_named_counts_among_the_code_that_a_result_depends_on() -> None:
    gain = {"name": "gain", "parameters": {"gain": 0.9}, "chamber": -1}
    found = SimpleNamespace(corrections=lambda: [gain], simulator_parameters={})
    assembly = Assembly(SimpleNamespace(), composed("stage=simulate", "effect=identified"), {})
    assembly._artifact = lambda kind: found
    assert assembly._chain().effects and {"softrl.effects.gain", Diagnosis.__module__} <= set(assembly.modules)


@pytest.mark.parametrize(("tuned", "corrected"), [({"damping_scale": 1.2}, True), ({}, False)])
def test_a_body_that_was_retuned_counts_as_corrected_without_any_effect(tuned: dict[str, float], corrected: bool) -> None:
    assembly = Assembly(SimpleNamespace(), composed("stage=sim2real", "effect=identified"), {})
    assembly._artifact = lambda kind: SimpleNamespace(corrections=list, simulator_parameters=tuned)
    assert not assembly._chain().effects and assembly._chain().corrected == corrected


@pytest.mark.parametrize("stage", STAGES + EXTRA)
def test_effects_are_refused_by_the_stages_that_take_none(stage: str) -> None:
    assembly = Assembly(SimpleNamespace(), composed(f"stage={stage}", "effect=[lag]"), {})
    run = importlib.import_module(f"softrl.{stage}.stage").run
    if stage in ("calibration", "rl", "sim2real", "simulate"):
        assembly.refuse_unused_effects(stage, run)
    else:
        with pytest.raises(ConfigError, match=f"effect=lag plays no part in stage={stage}; leave it out"):
            assembly.refuse_unused_effects(stage, run)
    Assembly(SimpleNamespace(), composed(f"stage={stage}", "effect=[]"), {}).refuse_unused_effects(stage, run)


def test_a_correction_is_applied_whole_or_not_at_all() -> None:
    """Among the stages of a loop are some that simulate and take no effects."""

    def takes_effects(config: object, simulator: Simulator, effects: EffectChain) -> None: ...

    def takes_none(config: object, simulator: Simulator) -> None: ...

    words = ("stage=diagnosis", "simulator=pcc", "robot=three_chamber_segment", "effect=identified")
    for run, mass in ((takes_effects, 1.5), (takes_none, 1.0)):
        assembly = Assembly(SimpleNamespace(), composed(*words), {})
        found = SimpleNamespace(corrections=list, simulator_name="PccSimulator", simulator_parameters={"mass_scale": 1.5})
        assembly._artifact = lambda kind, found=found: found
        assert assembly.arguments(run)["simulator"].parameters["mass_scale"] == mass


def test_a_correction_by_an_older_library_is_refused() -> None:
    with pytest.raises(ArtifactError, match="'strain_stiffening' a parameter 'cubic', unknown by now: run stage=diagnosis again"):
        _corrected_by("strain_stiffening", {"cubic": 2.0, "chamber": -1})
    assert _corrected_by("strain_stiffening", {"growth": 2.0, "chamber": 1}).chamber == 1


@pytest.mark.parametrize("words", [("effect=none",), ("effect=[]",), ()])
def test_no_effect_may_be_said_in_more_than_one_way(words: tuple[str, ...]) -> None:
    assembly = Assembly(SimpleNamespace(), composed("stage=simulate", *words), {})
    assert not assembly._chain().effects and assembly._effects_mark() == NOMINAL


def test_how_suddenly_an_effect_begins_needs_when() -> None:
    assembly = Assembly(SimpleNamespace(), composed("stage=simulate", "effect=[leak]", "+effect.leak.over_s=0.2"), {})
    with pytest.raises(ConfigError, match=r"leak.over_s=0.2 says how suddenly it begins; expected effect.leak.since_s > 0"):
        assembly._chain()
    late = composed("stage=simulate", "effect=[leak]", "+effect.leak.over_s=0.2", "+effect.leak.since_s=3")
    assert Assembly(SimpleNamespace(), late, {})._chain().effects[0].since_s == 3.0


@pytest.mark.parametrize("name", ["base_tilt", "asymmetry", "shared_flow", "crosstalk", "marker_offset"])
def test_an_effect_that_makes_no_sense_for_a_robot_is_refused(name: str) -> None:
    words = "stage=simulate", f"effect=[{name}]"
    with pytest.raises(ConfigError, match=rf"effect.{name} makes no sense for robot .*1 chamber.* output=bend_angle; leave it"):
        Assembly(SimpleNamespace(), composed(*words, "robot=single_chamber_finger"), {})._chain()
    assert Assembly(SimpleNamespace(), composed(*words), {})._chain().effects


def test_a_gate_above_all_pressures_is_refused() -> None:
    sucks = "robot.pressure_min_pa=-80000", "robot.pressure_max_pa=1000"
    for words, highest in ((("+effect.gain.above_share=0.3", *sucks), "0.0125"), (("+effect.gain.above_share=1",), "1")):
        with pytest.raises(ConfigError, match=rf"gain.above_share=\S+ is no pressure of .*expected less than {highest}, its"):
            Assembly(SimpleNamespace(), composed("stage=simulate", "effect=[gain]", *words), {})._chain()
    fits = composed("stage=simulate", "effect=[gain]", "+effect.gain.above_share=-0.5", *sucks)
    assert Assembly(SimpleNamespace(), fits, {})._chain().effects


def test_out_touches_no_folder_of_another_kind(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for taken in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(ConfigError, match="holds something else than a stage's results"):
            _own_folder(str(taken))
    (tmp_path / "result.json").write_text("{}")
    assert _own_folder(str(tmp_path)) == tmp_path and _own_folder(str(tmp_path / "new")) == tmp_path / "new"


@pytest.mark.parametrize(("number", "mine", "datasets"), [(3, "mine/3", "made/3"), ("???", "mine", "made")])
def test_each_point_of_a_sweep_has_a_folder_of_its_own(
    number: object, mine: str, datasets: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HydraConfig, "initialized", lambda: True)
    monkeypatch.setattr(HydraConfig, "get", lambda: OmegaConf.create({"job": {"num": number}}))
    assert composed("stage=mesh", "out=mine")["out"] == mine and composed("stage=mesh")["out"] is None
    assert composed("stage=simulate", "out=made")["stage"]["out"] == datasets
    assert composed("stage=excite", "stage.out=made")["stage"]["out"] == datasets


def test_out_keeps_nothing_of_what_an_earlier_run_left_there(tmp_path: Path) -> None:
    runs = {"a": ["figures/gain.png", "figures/map.png", "old/arrays.npz", "result.json"]}
    runs["b"] = ["figures/map.png", "result.json"]

    def copy(run_id: str, folder: Path) -> list[str]:
        for name in runs[run_id]:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(json.dumps({"run_id": run_id}))
        return runs[run_id]

    store: Any = SimpleNamespace(copy=copy)
    _copy(store, "a", tmp_path / "out")
    (tmp_path / "out/figures/notes.txt").write_text("mine")
    _copy(store, "b", tmp_path / "out")
    left = sorted(str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*"))
    assert left == ["figures", "figures/map.png", "figures/notes.txt", "result.json"]
    (tmp_path / "out/result.json").write_text('{"copied": ["../kept.txt", "result.json"]}')
    (tmp_path / "kept.txt").write_text("mine")
    _copy(store, "b", tmp_path / "out")
    assert (tmp_path / "kept.txt").read_text() == "mine", "nothing outside the folder is touched"
