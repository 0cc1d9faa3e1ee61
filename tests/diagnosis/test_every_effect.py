"""Every effect of the library, recorded as a laboratory would at 20 rows a second with a quick gauge, is found again."""

from dataclasses import replace

import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.hypothesis import has_chamber
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.library import effect_class, names
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made, node

ELSEWHERE = {"layer_stiffness", "thermal_softening"}  # need a body of layers, and a temperature: they have tests of their own
IN_ALL = {"gain", "crosstalk", "stiffness_scale"}  # retuning's work where they act on all chambers alike: tried in one alone
# what says the same of these recordings
ALIKE = {
    "failure": {"gain"},  # from the first seconds on
    "gain": {"pressure_sensor", "asymmetry", "failure"},
    "pressure_sensor": {"gain", "offset"},
    "command_map": {"offset", "gain", "knee"},
    "crosstalk": {"stiffness_scale", "asymmetry"},
    "stiffness_scale": {"gain", "asymmetry"},
    "supply_limit": {"knee"},
    "lag": {"tube_line"},
}


def hidden(name: str) -> Effect:
    """Return the effect as ``effect=[name]`` gives it."""
    values = node(f"effect/{name}.yaml")
    effect = effect_class(name)(**values)
    return replace(effect, chamber=0) if name in IN_ALL and has_chamber(name) else effect


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in names() if name not in ELSEWHERE])
def test_what_the_library_holds_is_found_again(body: PccSimulator, name: str) -> None:
    recordings = made(body, (hidden(name),), sessions=4, measured=True, period_s=0.05, noise_m=3e-4)
    found = run(configured(), body.robot, recordings, body, tracker=NullTracker())
    told = {effect["name"] for effect in found.effects} | {rival["name"] for rival in found.rivals if rival["equivalent"]}
    held = found.errors_mm["heldout"]
    if found.verdict == "nothing missing":
        assert held["retuned"] < 1.1 * held["noise_floor"], found.sentences  # too small to be told from another body
        return
    assert found.verdict in ("named", "indistinguishable"), found.sentences
    assert told & ({name} | ALIKE.get(name, set())), (name, told)
    assert held["corrected"] < 1.3 * held["noise_floor"]
