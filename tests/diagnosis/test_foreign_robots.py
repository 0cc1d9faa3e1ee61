"""What was left out is told of robots with one, two and four chambers, with and without gauges, at 10 to 50 samples a second."""

from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.read import read
from tests.diagnosis import foreign, foreign_robots
from tests.diagnosis.conftest import configured, node
from tests.diagnosis.foreign_robots import OTHERS, VALVE_S, Other, Physics

pytestmark = pytest.mark.slow
SEED = 5
THE_VALVE = ({"lag", "tube_line"},)


def weaker_last_chamber_midway(other: Other, pressure: np.ndarray) -> np.ndarray:
    late = (other.time > 0.5 * other.lasts_s)[:, None] & (np.arange(pressure.shape[1]) == pressure.shape[1] - 1)
    return np.where(late, 0.6 * pressure, pressure)


def relays(other: Other, pressure: np.ndarray) -> np.ndarray:
    """Return what acts where three tenths of the pressure do so through relays: a Preisach memory, loops 0.16 to 0.32 wide."""
    width, middle = np.meshgrid(np.linspace(0.16, 0.32, 5), np.linspace(-0.3, 1.3, 161))
    up, down = (middle + 0.5 * width).ravel()[:, None], (middle - 0.5 * width).ravel()[:, None]
    on, found = np.broadcast_to(middle.ravel()[:, None] < 0.0, (up.size, pressure.shape[1])).copy(), np.empty_like(pressure)
    for k, share in enumerate(pressure / other.full_pa):
        on = (on | (share >= up)) & (share > down)
        found[k] = other.full_pa * 1.6 * (on.mean(axis=0) - 0.3 / 1.6)
    return 0.7 * pressure + 0.3 * found


def from_one_neighbour(other: Other, pressure: np.ndarray) -> np.ndarray:
    """Return what acts where the last chamber feels a sixth of the first one's pressure."""
    return pressure + np.eye(pressure.shape[1])[-1] * pressure[:, :1] / 6.0


VALVES: dict[str, tuple[Physics, tuple[set[str], ...]]] = {
    "late": (lambda _, p: foreign.late(p, 0.2), ({"dead_time", "delay"},)),
    "rate": (lambda other, p: foreign.rate_limited(p, 0.4 * other.full_pa), ({"rate_limit"},)),
    "ceiling": (lambda other, p: np.minimum(p, 0.5 * other.full_pa), ({"supply_limit", "knee"},)),
}
SUPPLIES: dict[str, tuple[Physics, tuple[set[str], ...]]] = {
    "span": (lambda _, p: 0.85 * p, ({"gain"},)),
    "burst": (weaker_last_chamber_midway, ({"failure", "gain"},)),
}
BODIES: dict[str, tuple[Physics, tuple[set[str], ...]]] = {
    "creep": (lambda _, p: 0.8 * p + 0.3 * foreign.first_order(p, 5.0), ({"viscoelasticity"},)),
    "failure": (weaker_last_chamber_midway, ({"failure", "gain"},)),
    "drift": (lambda other, p: p * (1.0 + 0.3 * other.time / other.lasts_s)[:, None], ({"drift"},)),
}


def diagnosed(other: Other, folder: Path, valve: Physics | None = None, act: Physics | None = None) -> Diagnosis:
    robot = other.robot()
    body = PccSimulator(robot=robot, **node("simulator/pcc.yaml"))
    foreign_robots.write(other, folder, SEED, valve, act)
    return run(configured(search={"workers": 1}), robot, read(folder, robot), body, tracker=NullTracker())


def assert_named(found: Diagnosis, expected: tuple[set[str], ...]) -> None:
    """Assert that one effect of each set is named, and nothing else; and that it serves from the command."""
    names = [effect["name"] for effect in found.effects]
    assert len(names) == len(expected) and all(set(names) & some for some in expected), found.sentences
    assert found.verdict in ("named", "indistinguishable"), found.sentences
    held = found.errors_mm["heldout"]
    assert held["corrected"] < 1.05 * min(held["retuned"], held["one_lag"], held["blackbox"]), held


@pytest.mark.parametrize("name", OTHERS)
def test_nothing_but_the_valve_of_another_robot(tmp_path: Path, name: str) -> None:
    found = diagnosed(OTHERS[name], tmp_path)
    if not OTHERS[name].gauges:
        assert found.verdict == "nothing missing", found.sentences
        return
    assert_named(found, THE_VALVE)
    if found.effects[0]["name"] == "lag":
        told = [found.effects[0]["parameters"][key]["value"] for key in ("fill_s", "vent_s")]
        assert told == pytest.approx([VALVE_S, VALVE_S], rel=0.05)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("hidden", VALVES)
def test_what_the_valve_of_another_robot_does(tmp_path: Path, name: str, hidden: str) -> None:
    valve, expected = VALVES[hidden]
    found = diagnosed(OTHERS[name], tmp_path, valve)
    if OTHERS[name].gauges and hidden == "late" and len(found.effects) == 1:
        assert_a_lag_of_about_a_row_is_told_as_spread(found, 0.2)
    else:
        assert_named(found, (*expected, *THE_VALVE * OTHERS[name].gauges))


def assert_a_lag_of_about_a_row_is_told_as_spread(found: Diagnosis, late_s: float) -> None:
    """Ten or twenty rows a second hold little of a lag of 60 ms but its mean, which is the dead time's, and its variance."""
    assert_named(found, ({"dead_time"},))
    told = {key: found.effects[0]["parameters"][key] for key in ("delay_s", "dispersion")}
    assert told["delay_s"]["low"] - 0.005 < late_s + VALVE_S < told["delay_s"]["high"]
    spread_s = np.sqrt(told["dispersion"]["value"]) * told["delay_s"]["value"]
    assert spread_s == pytest.approx(VALVE_S, rel=0.2)
    assert any("may as well be a lag" in sentence for sentence in found.sentences)


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("hidden", BODIES)
def test_what_the_body_of_another_robot_does(tmp_path: Path, name: str, hidden: str) -> None:
    act, expected = BODIES[hidden]
    assert_named(diagnosed(OTHERS[name], tmp_path, act=act), (*expected, *THE_VALVE * OTHERS[name].gauges))


def test_a_memory_of_pressures_is_told_from_one_of_strains(tmp_path: Path) -> None:
    """Four chambers: each one's strain turns where any pressure does, its pressure where it does itself."""
    found = diagnosed(OTHERS["quad"], tmp_path, act=relays)
    assert_named(found, ({"pressure_play"}, *THE_VALVE))
    told = next(effect for effect in found.effects if effect["name"] == "pressure_play")["parameters"]
    assert told["share"]["value"] == pytest.approx(0.3, rel=0.1) and told["half_width"]["value"] == pytest.approx(0.12, rel=0.1)


def test_a_chamber_that_feels_one_of_three_others(tmp_path: Path) -> None:
    found = diagnosed(OTHERS["quad"], tmp_path, act=from_one_neighbour)
    assert_named(found, ({"crosstalk"}, *THE_VALVE))
    told = next(effect for effect in found.effects if effect["name"] == "crosstalk")
    assert told["chamber"] == 3 and told["parameters"]["lean"]["value"] == pytest.approx(1.0, abs=0.05)
    assert told["parameters"]["share"]["value"] == pytest.approx(1.0 / 12.0, rel=0.05)


@pytest.mark.parametrize("name", [name for name, other in OTHERS.items() if other.gauges])
@pytest.mark.parametrize("hidden", SUPPLIES)
def test_what_a_gauge_shows_of_a_chamber_is_named_before_it(tmp_path: Path, name: str, hidden: str) -> None:
    valve, expected = SUPPLIES[hidden]
    found = diagnosed(OTHERS[name], tmp_path, valve)
    assert_named(found, (*expected, *THE_VALVE))
    (told,) = [effect for effect in found.effects if effect["name"] in expected[0]]
    assert "before the gauge" in told["where"] and told["pinned"]["before_gauge"]
