"""Artifacts come back as they were, whole or not at all, and refuse what does not fit."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from softrl.artifacts.artifact import META, Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class Sample(Artifact):
    stage: ClassVar[str] = "fem"

    table: np.ndarray
    weights: dict[str, np.ndarray]
    names: tuple[str, ...]
    facts: dict[str, Any]


@pytest.fixture
def sample() -> Sample:
    rng = np.random.default_rng(0)
    return Sample(rng.normal(size=(4, 3)), {"net.0.weight": rng.normal(size=(2, 2))}, ("a", "b"), {"n": 2, "z": None})


def test_round_trip(sample: Sample, tmp_path: Path) -> None:
    sample.save(tmp_path / "x")
    back = Sample.load(tmp_path / "x")
    np.testing.assert_array_equal(back.table, sample.table)
    np.testing.assert_array_equal(back.weights["net.0.weight"], sample.weights["net.0.weight"])
    assert (back.names, back.facts) == (sample.names, sample.facts)


def test_nan_is_refused_and_the_earlier_artifact_stays(sample: Sample, tmp_path: Path) -> None:
    sample.save(tmp_path / "x")
    bad = replace(sample, table=np.array([np.nan]))
    with pytest.raises(ArtifactError, match="table holds 1 values that are not finite"):
        bad.save(tmp_path / "x")
    np.testing.assert_array_equal(Sample.load(tmp_path / "x").table, sample.table)


def test_another_schema_or_kind_is_refused(sample: Sample, tmp_path: Path) -> None:
    sample.save(tmp_path / "x")
    meta = json.loads((tmp_path / "x" / META).read_text())
    (tmp_path / "x" / META).write_text(json.dumps(meta | {"schema": 99}))
    with pytest.raises(ArtifactError, match="rerun stage=fem"):
        Sample.load(tmp_path / "x")
    (tmp_path / "x" / META).write_text(json.dumps(meta | {"kind": "Mesh"}))
    with pytest.raises(ArtifactError, match="holds a Mesh"):
        Sample.load(tmp_path / "x")


def test_pickled_objects_are_never_read(sample: Sample, tmp_path: Path) -> None:
    sample.save(tmp_path / "x")
    np.savez(tmp_path / "x" / "arrays.npz", table=np.array([{"evil": 1}], dtype=object))
    with pytest.raises(ArtifactError, match=r"damaged Sample .*allow_pickle"):
        Sample.load(tmp_path / "x")


@pytest.mark.parametrize("damage", ["cut", "missing", "{", "{}", "[]"])
def test_a_damaged_artifact_is_told_in_one_line(damage: str, sample: Sample, tmp_path: Path) -> None:
    sample.save(tmp_path / "x")
    arrays, meta = tmp_path / "x/arrays.npz", tmp_path / "x" / META
    if damage == "cut":
        arrays.write_bytes(arrays.read_bytes()[:100])
    elif damage == "missing":
        np.savez(arrays, table=sample.table[:, 0])
        meta.write_text(meta.read_text().replace('"names"', '"other"'))
    else:
        meta.write_text(damage)
    with pytest.raises(ArtifactError, match=r"holds a damaged Sample .*; rerun stage=fem"):
        Sample.load(tmp_path / "x")


def test_a_page_that_was_lost_is_told_in_one_line(sample: Sample, tmp_path: Path) -> None:
    """As a power cut leaves it: zeros within a file of the right length."""
    large = replace(sample, table=np.random.default_rng(0).random((2000, 3)))
    large.save(tmp_path / "x")
    arrays = tmp_path / "x/arrays.npz"
    whole = arrays.read_bytes()
    for start in np.linspace(0, len(whole) - 4096, 100).astype(int):
        arrays.write_bytes(whole[:start] + bytes(4096) + whole[start + 4096 :])
        with pytest.raises(ArtifactError, match=r"holds a damaged Sample .*; rerun stage=fem"):
            Sample.load(tmp_path / "x")
