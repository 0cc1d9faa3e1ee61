"""Parts of long work outlive a process that is done with them, as long as another one uses them."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from softrl.core.resume import Kept

ROOT = Path(__file__).resolve().parents[2]
OTHER = """
import sys
from pathlib import Path
from softrl.core.resume import Kept
kept = Kept("work", "mark", Path(sys.argv[1]))
print("part" in kept, flush=True)
sys.stdin.readline()
print(kept.load("part")["x"][0], flush=True)
kept.clear()
"""


def test_the_last_process_to_end_removes_the_folder(tmp_path: Path) -> None:
    mine = Kept("work", "mark", tmp_path / "home")
    mine.save("part", {"x": np.arange(3) + 7})
    other = subprocess.Popen(
        [sys.executable, "-c", OTHER, str(tmp_path / "home")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert other.stdout is not None and other.stdin is not None
    assert other.stdout.readline() == "True\n"
    mine.clear()
    assert "part" in Kept("work", "mark", tmp_path / "home")
    mine.clear()
    told, _ = other.communicate("go on\n")
    assert (told, other.returncode) == ("7\n", 0)
    assert list(tmp_path.iterdir()) == []


def test_a_process_alone_removes_what_an_earlier_one_left(tmp_path: Path) -> None:
    script = OTHER.replace("print(", "kept.save('part', {'x': sys.argv}); print(", 1).split("sys.stdin")[0]
    subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "home")], env=os.environ | {"PYTHONPATH": str(ROOT)}, check=True
    )
    mine = Kept("work", "mark", tmp_path / "home")
    assert "part" in mine
    mine.clear()
    assert list(tmp_path.iterdir()) == []


def test_a_parent_that_is_in_use_or_gone_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, other = (Kept("work", mark, tmp_path / "home") for mark in ("a", "b"))
    other.save("part", {"x": np.zeros(1)})
    kept.save("part", {"x": np.zeros(1)})
    kept.clear()
    assert "part" in other
    other.clear()
    other.clear()
    assert list(tmp_path.iterdir()) == []


def test_parents_that_vanish_under_many_users_are_made_again(tmp_path: Path) -> None:
    failed: list[BaseException] = []

    def work(mark: str) -> None:
        try:
            for _ in range(100):
                kept = Kept("work", mark, tmp_path / "home")
                kept.save("part", {"x": np.zeros(1)})
                kept.load("part")
                kept.clear()
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(mark,)) for mark in "abc"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
