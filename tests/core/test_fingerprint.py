"""Fingerprints change with what can change a result, and with nothing else."""

from pathlib import Path

import pytest

from softrl.core import fingerprint


def test_order_of_keys_does_not_matter_but_values_do() -> None:
    assert fingerprint.of_values({"a": 1, "b": 2}) == fingerprint.of_values({"b": 2, "a": 1})
    assert fingerprint.of_values({"a": 1}) != fingerprint.of_values({"a": 2})


def test_a_file_that_changes_under_the_same_name_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "mesh.stl"
    path.write_text("one")
    before = fingerprint.of_named_files({"stage": {"source": str(path), "others": [str(path)]}})
    path.write_text("two")
    assert fingerprint.of_named_files({"stage": {"source": str(path)}}) != before
    assert set(before) == {str(path)}


def test_a_file_that_is_read_with_the_named_one_counts(tmp_path: Path) -> None:
    named, beside = tmp_path / "body.ele", tmp_path / "body.node"
    named.write_text("elements")
    marks = []
    for points in ("here", "there"):
        beside.write_text(points)
        (tmp_path / "body.png").write_text(points)
        marks.append(fingerprint.of_named_files({"source": str(named)}))
    assert set(marks[0]) == {str(named), str(beside)}
    assert marks[0] != marks[1]


def test_code_follows_imports_into_the_package_only() -> None:
    one = fingerprint.of_code("softrl.effects.lag")
    assert one == fingerprint.of_code("softrl.effects.lag")
    assert one != fingerprint.of_code("softrl.effects.leak")
    assert fingerprint.of_code("numpy") == fingerprint.of_code()


def test_code_that_is_loaded_by_name_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    before, read = fingerprint.of_code("softrl.diagnosis.stage"), fingerprint._source
    monkeypatch.setattr(fingerprint, "_source", lambda name: read(name) + "#" * (name == "softrl.effects.tether"))
    assert fingerprint.of_code("softrl.diagnosis.stage") != before
