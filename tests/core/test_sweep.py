"""A sweep's parent run gets the figures that the room of its stage draws."""

from types import SimpleNamespace

import pytest

from softrl.core import sweep
from softrl.core.sweep import Point, spread_by


class Parent:
    """A parent run with finished children; keeps the names of the figures put on it."""

    def __init__(self, stage: str, points: list[Point]) -> None:
        self.id, self.figures = "p", []
        self.run = SimpleNamespace(data=SimpleNamespace(tags={"softrl.stage": f"sweep:{stage}"}))
        self.runs = [SimpleNamespace(data=SimpleNamespace(params=p.params, metrics=p.metrics)) for p in points]

    def figure(self, name: str, figure: object) -> None:
        self.figures.append(name)


def force_point(alpha: str, position: float, force: float) -> Point:
    metrics = {"circle_position_rmse_mm": position, "circle_force_rmse_n": force, "expert_circle_force_rmse_n": 0.1}
    return Point({"alpha": alpha}, {f"heldout/{name}": value for name, value in metrics.items()})


def physics_point(weight: str, runs: str) -> Point:
    names = [f"heldout/{b}position_{k}_mm" for b in ("", "arx_") for k in ("onestep", "rollout")]
    return Point({"lambda": weight, "stage.training_runs": runs}, dict.fromkeys(names, 1.0))


FORCE = [force_point("0.1", 2.0, 0.1), force_point("0.9", 1.0, 0.3)]
PHYSICS = [physics_point("0.0", "1"), physics_point("0.1", "10")]


@pytest.mark.parametrize(
    ("stage", "points", "expected"),
    [
        ("rl", FORCE, ["alpha"]),
        ("rl", [Point({"alpha": "0.5"}, {"heldout/circle_position_rmse_mm": 1.0})] * 2, []),  # nothing is touched
        ("rl", FORCE[:1] * 3, []),  # several seeds of one alpha are no front
        ("dynamics", PHYSICS, ["physics_weight"]),
        ("dynamics", PHYSICS[:1], []),
        ("mesh", FORCE, []),
        ("all", FORCE, []),
    ],
)
def test_the_room_of_a_stage_draws(stage: str, points: list[Point], expected: list[str]) -> None:
    parent = Parent(stage, points)
    sweep._draw(parent, parent.runs)
    assert parent.figures == expected


def test_seeds_are_brought_together() -> None:
    points = [Point({"alpha": "0.5", "seed": str(s)}, {"m": float(s)}) for s in (1, 3)] + [Point({"alpha": "1"}, {})]
    assert spread_by(points, "alpha", "m") == {"0.5": (2.0, 1.0)}
