"""What is fetched from a tracking server is there whole or not at all; a project may be moved, and keeps its runs."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from softrl.core.store import Location, Store, write_text

RUN: Any = SimpleNamespace(info=SimpleNamespace(run_id="a1", artifact_uri="mlflow-artifacts:/1/a1/artifacts"))


class Server:
    """A client of a server whose line breaks after the first of two files, as often as it is told to."""

    def __init__(self, breaks: int) -> None:
        self.breaks, self.downloads = breaks, 0

    def download_artifacts(self, run_id: str, path: str, dst_path: str) -> str:
        self.downloads += 1
        folder = Path(dst_path) / path
        folder.mkdir(parents=True)
        (folder / "meta.json").write_text("{}")
        if self.downloads <= self.breaks:
            raise ConnectionError("cable")
        (folder / "arrays.npz").write_bytes(b"all")
        return str(folder)


def store_of(server: Server, folder: Path) -> Store:
    store = object.__new__(Store)
    store._cache, store.client = folder / "mlcache", server  # type: ignore[assignment]
    return store


def test_a_file_that_a_run_does_not_have_is_not_fetched(tmp_path: Path) -> None:
    server = Server(breaks=0)
    server.list_artifacts = lambda run_id: [SimpleNamespace(path="snapshots")]  # type: ignore[attr-defined]
    store = store_of(server, tmp_path)
    assert store.file(RUN, "report.html") is None and server.downloads == 0
    assert store.file(RUN, "snapshots") == store.folder(RUN, "snapshots")


def test_a_download_that_was_broken_off_is_not_taken_for_whole(tmp_path: Path) -> None:
    server = Server(breaks=1)
    store = store_of(server, tmp_path)
    with pytest.raises(ConnectionError):
        store.folder(RUN, "snapshots")
    found = store.folder(RUN, "snapshots")
    assert sorted(file.name for file in found.iterdir()) == ["arrays.npz", "meta.json"]
    assert store.folder(RUN, "snapshots") == found and server.downloads == 2, "what is whole is not fetched again"
    assert list(found.parent.iterdir()) == [found]


def test_two_that_fetch_at_once_do_not_meet(tmp_path: Path) -> None:
    class Slow(Server):
        def download_artifacts(self, run_id: str, path: str, dst_path: str) -> str:
            made = super().download_artifacts(run_id, path, dst_path)
            if self.downloads == 1:
                store.folder(RUN, path)  # another process is faster
            return made

    store = store_of(Slow(breaks=0), tmp_path)
    found = store.folder(RUN, "snapshots")
    assert (found / "arrays.npz").is_file() and list(found.parent.iterdir()) == [found]


def test_two_that_write_one_file_at_once_do_not_meet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rename = Path.rename

    def slow(part: Path, target: Path) -> Path:
        monkeypatch.setattr(Path, "rename", rename)
        monkeypatch.setattr(os, "getpid", lambda: 1)
        write_text(target, "another process is faster")
        return rename(part, target)

    monkeypatch.setattr(Path, "rename", slow)
    write_text(tmp_path / "result.json", "{}")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["{}"]


def test_a_project_that_was_moved_keeps_its_runs_where_it_is(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    before, after = tmp_path / "my lab #1 50%", tmp_path / "moved, renamed"

    def record(folder: Path, word: str) -> str:
        with Store(Location(None, str(folder))).start(word, {"stage": "mesh"}, None) as run:
            run.text("word.txt", word)
            run.text("figures/word.txt", word)
        return run.id

    def said(folder: Path, run_id: str) -> str:
        store = Store(Location(None, str(folder)))
        found = store.file(store.get(run_id), "word.txt")
        assert found is not None and found.is_relative_to(folder)
        assert store.copy(run_id, tmp_path / "copied") == ["figures/word.txt", "word.txt"]
        assert (tmp_path / "copied" / "word.txt").read_text() == found.read_text()
        return found.read_text()

    old, lost = record(before, "old"), record(before, "lost")
    shutil.move(before / "mlartifacts" / lost, tmp_path)
    shutil.move(before, after)
    assert said(after, old) == "old" and f"kept in {before}, and are in {after} since" in caplog.text
    assert said(after, record(after, "new")) == "new" and not before.exists(), "the old folder does not come again"
    store = Store(Location(None, str(after)))
    assert store.get(lost).info.artifact_uri.startswith(before.as_uri()), "whose files were not moved stays where it was"
    assert caplog.text.count("are in") == 1, "once is enough"
