"""Every configuration composes, spells every field of its class, and is built without a run."""

import importlib
import typing
from pathlib import Path

import hydra
import pytest
from omegaconf import OmegaConf

from softrl.artifacts.artifact import Artifact
from softrl.assembly import _without_none, output_kinds
from softrl.core.config import build, constructor_hints, target_class
from softrl.pipeline import EXTRA, STAGES
from softrl.recordings.recording import RecordingSet

CONF = Path(__file__).resolve().parents[2] / "conf"
GROUPS = ("robot", "simulator", "task", "agent", "driver", "effect", "bench")
OPTIONS = [f"{group}={path.stem}" for group in GROUPS for path in sorted((CONF / group).glob("*.yaml"))]


def composed(*overrides: str) -> dict[str, typing.Any]:
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        node = OmegaConf.to_container(hydra.compose("config", list(overrides)), resolve=True)
    assert isinstance(node, dict)
    return node


@pytest.mark.parametrize("profile", ["tiny", "quick", "paper"])
@pytest.mark.parametrize("stage", STAGES + EXTRA)
def test_stage_config_mirrors_its_class(stage: str, profile: str) -> None:
    node = composed(f"stage={stage}", f"profile={profile}")["stage"]
    config = importlib.import_module(f"softrl.{stage}.stage").Config
    required = {name for name, (_, needed) in constructor_hints(config).items()}
    assert set(node) == required
    build(node, config, "stage")


@pytest.mark.parametrize("option", OPTIONS)
def test_option_composes_and_names_a_class_of_ours(option: str) -> None:
    node = composed("stage=mesh", option)
    group = option.split("=")[0]
    chosen = node[group]
    if group == "robot":
        return
    for value in chosen.values() if group in ("effect", "bench") else [chosen]:
        if isinstance(value, dict) and "_target_" in value:
            keys = set(value) - {"_target_"}
            assert keys <= set(constructor_hints(target_class(value, option)))


def test_help_tells_what_stages_take_and_make() -> None:
    lines = OmegaConf.load(CONF / "hydra/help/softrl.yaml")._get_node("template")._value().splitlines()
    told = {line.split()[0]: line for line in lines if line.strip()}
    for stage in STAGES + EXTRA:
        run = importlib.import_module(f"softrl.{stage}.stage").run
        kinds = [_without_none(hint) for name, hint in typing.get_type_hints(run).items() if name != "return"]
        taken = {f"({k.key()})" if optional else k.key() for k, optional in kinds
                 if isinstance(k, type) and issubclass(k, Artifact) and not (k is RecordingSet and optional)}  # fmt: skip
        made = {kind.key() for kind in output_kinds(run)}
        assert sorted(told[stage].split()[1:]) == sorted([*(taken or "-"), *made]), stage


@pytest.mark.parametrize("profile", ["tiny", "paper"])
def test_a_profile_changes_what_it_names_and_nothing_else(profile: str) -> None:
    for path in sorted((CONF / "profile" / profile).glob("*.yaml")):
        node, base = (composed(f"stage={path.stem}", f"profile={name}")["stage"] for name in (profile, "quick"))
        overlay = OmegaConf.load(path)
        assert set(overlay) <= set(base), path
        changed = OmegaConf.to_container(OmegaConf.merge(base, overlay))
        assert node == changed, path
