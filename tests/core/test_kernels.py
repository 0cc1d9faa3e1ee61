"""A kernel that calls a changed one is compiled anew."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import softrl
from softrl.core.kernels import compiled_sources, keep_by_code, mark_of

DECORATED = re.compile(r"^\s*@(standing|standing_as|borrowing|summing|(nb|numba)\.\w*jit)\b", re.MULTILINE)
INNER = "import numba\n@numba.njit(cache=True)\ndef inner():\n    return {value}\n"
OUTER = "import numba\nfrom inner import inner\n@numba.njit(cache=True)\ndef outer():\n    return inner()\n"
CALL = (
    "import sys; from pathlib import Path; from softrl.core.kernels import keep_by_code; "
    "keep_by_code(Path(sys.argv[1])); sys.path.insert(0, sys.argv[1]); from outer import outer; print(outer())"
)


def test_kernels_of_this_process_are_kept_by_their_code() -> None:
    assert Path(numba.config.CACHE_DIR).name == f"kernels-{mark_of(Path(softrl.__file__).parent)}"


def test_a_changed_kernel_reaches_those_that_call_it(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(OUTER)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = []
    for value in (1, 1, 2):
        (tmp_path / "inner.py").write_text(INNER.format(value=value))
        done = subprocess.run(
            [sys.executable, "-c", CALL, str(tmp_path)], env=environment, capture_output=True, text=True, check=True
        )
        told.append(done.stdout.strip())
    assert told == ["1", "1", "2"]


def test_every_file_with_kernels_and_every_constant_in_them_is_in_the_mark() -> None:
    package = Path(softrl.__file__).parent
    decorated = {
        path.relative_to(package).as_posix() for path in package.rglob("*.py") if DECORATED.search(path.read_text())
    }
    assert {"pod/lanes/newtons.py", "pcc/forces.py", "fem/law.py"} <= decorated
    held = set(compiled_sources(package))
    assert sorted(decorated - held) == []
    assert {"artifacts/reduced_model.py", "core/compiled.py", "effects/effect.py"} <= held


@pytest.mark.parametrize("changed", ["size.py", "shape.py", "inner.py"])
def test_the_mark_changes_with_kernels_and_with_constants(tmp_path: Path, changed: str) -> None:
    package = tmp_path / "arm"
    package.mkdir()
    sources = {
        "inner.py": "from softrl.core.compiled import borrowing\nfrom arm.size import (\n    SIZE,\n    Size,\n)\n",
        "size.py": "from arm.shape import SHAPES\nSIZE = 2 * SHAPES\n",
        "shape.py": "SHAPES = 3\n",
        "plain.py": "from arm.size import SIZE\n",
    }
    for name, source in sources.items():
        (package / name).write_text(source)
    before = mark_of(package)
    (package / "plain.py").write_text("from arm.size import SIZE\nTWICE = 2 * SIZE\n")
    assert mark_of(package) == before
    (package / changed).write_text(sources[changed] + "OTHER = 1\n")
    assert mark_of(package) != before


def test_old_folders_are_forgotten_and_others_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)
    old, young = tmp_path / "kernels-old", tmp_path / "kernels-young"
    for folder in (old, young):
        folder.mkdir()
    os.utime(old, (0.0, 0.0))
    keep_by_code(Path(softrl.__file__).parent)
    assert not old.exists() and young.exists()
