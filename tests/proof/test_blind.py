"""Whoever diagnoses cannot see what was hidden: not by import, not in the recordings' folder."""

import ast
import importlib.util
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.effects.library import names
from softrl.pcc.simulator import PccSimulator
from softrl.proof.generator.catalogue import CONCEALED, OUTSIDE, PAIRS, RIGHT, draw, frozen
from softrl.proof.generator.plan import STRATA, Case, plan, shares
from softrl.proof.judging import answer
from softrl.proof.trial import make, of_case
from softrl.robots.robot import Robot
from tests.proof.conftest import configured

PACKAGE = Path(__file__).resolve().parents[2] / "softrl"
# changes with every word of the table of right answers: a change is a decision that voids what was measured before
FROZEN = "1b7b392d039fb009"


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def reached(start: list[Path]) -> set[str]:
    """Names of all modules of the package that the files import, directly or through others."""
    seen: set[str] = set()
    waiting = [name for path in start for name in imports(path)]
    while waiting:
        name = waiting.pop()
        if not name.startswith("softrl.") or name in seen:
            continue
        seen.add(name)
        spec = _spec(name)
        if spec is not None:
            waiting += imports(spec)
    return seen


def _spec(name: str) -> Path | None:
    try:
        found = importlib.util.find_spec(name)
    except (ModuleNotFoundError, AttributeError):
        return None
    return Path(found.origin) if found and found.origin else None


@pytest.mark.parametrize("room", ["diagnosis", "effects", "pcc", "recordings"])
def test_no_way_leads_from_the_judged_to_the_generator(room: str) -> None:
    assert not [n for n in reached(list((PACKAGE / room).rglob("*.py"))) if n.startswith("softrl.proof")]
    for path in (PACKAGE / room).rglob("*.py"):
        assert "softrl.proof" not in path.read_text(), path


def test_the_generator_shares_no_code_with_what_it_tests() -> None:
    outside = [
        n
        for n in reached(list((PACKAGE / "proof/generator").rglob("*.py")))
        if not n.startswith("softrl.proof.generator")
    ]
    assert outside == []


def test_the_table_of_right_answers_is_frozen() -> None:
    assert frozen().startswith(FROZEN), "the table changed: numbers measured with another table are void"


def test_right_answers_are_members_of_the_library_and_outsiders_have_none() -> None:
    for name, (_, right, _) in RIGHT.items():
        assert right and set(right) <= set(names()), name
    assert not set(OUTSIDE) & set(RIGHT)
    assert all(draw(name, "everywhere", 30.0, 3, np.random.default_rng(0)).right == () for name in OUTSIDE)
    assert {name for pair in PAIRS for name in pair} | {name for name, _ in CONCEALED} <= set(RIGHT)


@pytest.mark.parametrize("cases", [3, 24, 120])
def test_strata_are_as_large_as_promised(cases: int) -> None:
    planned = plan(cases, 0)
    count = {stratum: sum(case.stratum == stratum for case in planned) for stratum in STRATA}
    assert count == shares(cases) and sum(count.values()) == cases
    assert count["null"] + count["nuisance"] >= 0.3 * cases and count["outside"] >= 0.15 * cases
    assert plan(cases, 0) == planned and plan(cases, 1) != planned


def made_case(folder: Path, robot: Robot, entries: tuple[tuple[str, str], ...], level: float) -> dict[str, object]:
    config = configured(generator={"sessions": 4, "session_s": 20.0})
    nominal = PccSimulator(
        robot, **vars(config.nominal), bending_stiffness_scale=1.0, axial_stiffness_scale=1.0, mass_scale=1.0
    )
    case = Case(7, "single" if entries else "null", entries, level, True, 11)
    return make(case, config.generator, robot, nominal, folder)


def test_nothing_in_a_folder_of_recordings_tells_what_is_hidden(tmp_path: Path, tripod: Robot) -> None:
    entry = made_case(tmp_path, tripod, (("mass", "everywhere"),), 10.0)
    folder = tmp_path / "recordings" / str(entry["folder"])
    files = sorted(path.name for path in folder.iterdir())
    assert all(re.fullmatch(r"[0-9a-f]{12}\.csv|dataset\.yaml", name) for name in files) and len(files) == 5
    head = yaml.safe_load((folder / "dataset.yaml").read_text())
    assert set(head) == {"robot", "frame", "units", "sessions"}
    assert all(
        re.fullmatch(r"[0-9a-f]{12}", name) and set(extra) == {"runs"} for name, extra in head["sessions"].items()
    )
    words = {*RIGHT, *OUTSIDE, *STRATA, *names()} - {"frame"}
    text = (folder / "dataset.yaml").read_text() + "".join((folder / f).open().readline() for f in files)
    assert not [word for word in words if re.search(rf"\b{word}\b", text)]
    sealed = str(entry["files_sha256"])
    assert sealed == of_case(tmp_path, str(entry["folder"]))
    for kept in (next(folder.glob("*.csv")), *(tmp_path / "outside").glob("*/*.csv"), *(tmp_path / "truth").iterdir()):
        before = kept.read_bytes()
        kept.write_bytes(before[:-1])
        assert of_case(tmp_path, str(entry["folder"])) != sealed, "what judges is sealed as well as what is diagnosed"
        kept.write_bytes(before)
    assert {path.name for path in tmp_path.iterdir()} == {"recordings", "outside", "truth"}


@pytest.mark.slow
def test_names_and_order_do_not_sway_the_verdict(tmp_path: Path, tripod: Robot) -> None:
    config = configured(diagnosis={"numerics": {"dt_s": 0.02}})
    nominal = PccSimulator(
        tripod, **vars(config.nominal), bending_stiffness_scale=1.0, axial_stiffness_scale=1.0, mass_scale=1.0
    )
    entry = made_case(tmp_path, tripod, (("spool", "everywhere"),), 15.0)
    folder = tmp_path / "recordings" / str(entry["folder"])
    other = tmp_path / "renamed"
    other.mkdir()
    head = yaml.safe_load((folder / "dataset.yaml").read_text())
    sessions = {}
    for number, entries in enumerate(reversed(head["sessions"].values())):
        sessions[f"day_{number}"] = {"runs": [f"run_{number}"]}
        shutil.copy(folder / f"{entries['runs'][0]}.csv", other / f"run_{number}.csv")
    (other / "dataset.yaml").write_text(yaml.safe_dump(head | {"sessions": sessions}))
    before, after = (answer(place, tripod, nominal, config.diagnosis) for place in (folder, other))
    assert before["verdict"] == after["verdict"]
    assert [e["name"] for e in before["effects"]] == [e["name"] for e in after["effects"]]
