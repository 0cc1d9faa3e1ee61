"""Imports run one way: foundations below rooms, rooms in the order of the loop, heavy libraries in one room each."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "softrl"
LEVEL = {
    "core": 0,
    "artifacts": 1,
    "robots": 1,
    "recordings": 2,
    "effects": 3,
    "report": 3,
    "mesh": 10,
    "fem": 11,
    "pod": 12,
    "pcc": 12,
    "excite": 12,
    "calibration": 13,
    "dynamics": 14,
    "surrogate": 15,
    "rl": 16,
    "sim2real": 17,
    "diagnosis": 14,
    "simulate": 17,
    "bench": 18,
    "proof": 18,
    "assembly": 20,
    "pipeline": 21,
    "aside": 22,
    "paper": 22,
    "loop": 23,
    "__main__": 24,
}
FLOORS = {  # of the rooms that have several: what stands in the room itself counts by its own name
    "diagnosis": ["series", "fitting", "checks", "search", "judging", "telling", "stage"],
    "pod": ["step", "lanes", "twin", "rom", "simulator", "fitting", "galerkin", "report", "convergence", "figures", "stage"],
}
OWNER = {
    "mlflow": {"core"},
    "pybullet": {"surrogate"},
    "stable_baselines3": {"rl"},
    "gymnasium": {"rl"},
    "pytetwild": {"mesh"},
    "manifold3d": {"mesh"},
    "meshio": {"mesh"},
    "hydra": {"core", "loop", "__main__"},
    "torch": {"calibration", "dynamics", "surrogate", "rl", "pod"},
}
FILES = sorted(PACKAGE.rglob("*.py"))


def room(path: Path) -> str:
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


def imported(path: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names += [f"{node.module}.{alias.name}" for alias in node.names] if node.module.split(".")[0] == "softrl" else []
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_upward_import(path: Path) -> None:
    own = room(path)
    if own == "__init__":
        return
    for name in imported(path):
        if name.startswith("softrl."):
            other = name.split(".")[1]
            allowed = other == own or LEVEL[other] < LEVEL[own]
            assert allowed, f"{path.relative_to(ROOT)} ({own}) imports {name}, which is not below it"


@pytest.mark.parametrize("place", FLOORS)
def test_floors_of_a_room_import_downward(place: str) -> None:
    rank = {floor: level for level, floor in enumerate(FLOORS[place])}
    for path in (PACKAGE / place).rglob("*.py"):
        own = path.relative_to(PACKAGE / place).parts[0].removesuffix(".py")
        for name in imported(path):
            other = name.split(".")[2] if name.startswith(f"softrl.{place}.") else own
            assert rank.get(other, 0) <= rank.get(own, len(rank)), f"{path.relative_to(ROOT)} imports {name}, which is not below"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_heavy_libraries_stay_in_their_rooms(path: Path) -> None:
    for name in imported(path):
        owners = OWNER.get(name.split(".")[0])
        assert owners is None or room(path) in owners, f"{path.relative_to(ROOT)} imports {name}; only {owners} may"


def test_judge_cannot_see_the_rig() -> None:
    for path in (PACKAGE / "diagnosis").rglob("*.py"):
        assert not [n for n in imported(path) if n.startswith(("softrl.sim2real", "softrl.rl"))], path


def test_no_circle_between_modules() -> None:
    modules = {".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p for p in FILES}
    graph = {name: {m for m in _resolved(imported(path), modules) if m != name} for name, path in modules.items()}
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join([*trail[trail.index(name) :], name])
        if name not in done:
            for other in graph[name]:
                visit(other, (*trail, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def _resolved(names: list[str], modules: dict[str, Path]) -> set[str]:
    return {name for name in names if name in modules and name != "softrl"}
