"""Laws of every effect in conf/effect: neutral, pure, finite, first order in the step, visible, round trip."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.core.errors import ConfigError
from softrl.core.simulator import Motion
from softrl.core.span import held
from softrl.effects import library
from softrl.effects.chain import EffectChain, Plant, SignalFilter, chain_of
from softrl.effects.effect import SITES, Effect
from softrl.effects.port import LOAD_PORT_ROWS, body_port
from softrl.pcc.simulator import PccSimulator
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"
NODES = {path.stem: yaml.safe_load(path.read_text()) for path in sorted((CONF / "effect").glob("*.yaml"))}
NAMES = [name for name, node in NODES.items() if node and "_target_" in node]
LAYERED = [name for name in NAMES if library.effect_class(name).layered]  # tests/pod/test_layers.py: bodies that have layers
ACTING = [name for name in NAMES if name not in LAYERED]
ROBOTS = ("tripod", "three_chamber_segment", "single_chamber_finger")
WARMING = np.linspace(22.0, 40.0, 13)  # degree Celsius, one a second


@cache
def simulator(robot: str = "tripod") -> PccSimulator:
    data = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    data.pop("_target_")
    return PccSimulator(Robot(**yaml.safe_load((CONF / "robot" / f"{robot}.yaml").read_text())), **data)


def configured(name: str) -> Effect:
    return library.effect_class(name)(**{k: v for k, v in NODES[name].items() if k != "_target_"})


def typical(name: str) -> Effect:
    cls = library.effect_class(name)
    return cls(**{f.name: f.metadata["typical"] for f in cls.parameter_fields()})


def program(robot: Robot, dt_s: float, duration_s: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Return a smooth program from rest through most of the chambers' range, with reversals."""
    time = dt_s * np.arange(1, round(duration_s / dt_s) + 1)
    wave = np.sin(np.outer(time, np.array([1.0, 1.37, 0.71])[: robot.chambers])) ** 2
    return time, 0.9 * robot.pressure_max_pa * wave * np.minimum(time / 2.0, 1.0)[:, None]


def simulate(effects: list[Effect], dt_s: float = 0.01, robot: str = "tripod") -> Motion:
    body = simulator(robot)
    chain = EffectChain(body.robot, tuple(effects), temperature=WARMING)
    return Plant(body, chain).simulate(*program(body.robot, dt_s))


def example_input(effect: Effect, robot: Robot) -> np.ndarray:
    rng = np.random.default_rng(4)
    if effect.site == "body":
        return rng.normal(0.0, 0.05, body_port(robot.chambers).shape)
    if effect.site == "load":
        return rng.normal(0.0, 0.1, (LOAD_PORT_ROWS, 3))
    if effect.site == "sensor" and effect.channel == "pose":
        return np.array([0.01, 0.02, 0.17, 0.96, 0.0, 0.28, 0.0])
    return np.array([12e3, 3e3, 25e3])[: robot.chambers]


def test_catalogue_and_configs_name_the_same_effects() -> None:
    assert library.names() == NAMES
    assert {library.effect_class(name).site for name in NAMES} == set(SITES)
    with pytest.raises(ConfigError, match="'gravity_waves' is unknown"):
        library.effect_class("gravity_waves")


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_it_is(name: str) -> None:
    """One line of what it stands for, an equation, its source or that none was checked, and a unit per parameter."""
    cls = library.effect_class(name)
    text = " ".join((cls.__doc__ or "").split())
    assert "``" in text, "an equation in the docstring"
    assert "no equation number checked" in text or "[Hong 2025]" in text, "a source in the docstring"
    assert list(cls.parameter_fields()) and all(f.metadata["unit"] for f in cls.parameter_fields())
    assert not cls.variant_of or library.effect_class(cls.variant_of).site == cls.site
    sites = {"valve", *(part.site for part in cls.neutral().parts())}
    assert not cls.extends or library.effect_class(cls.extends).site in sites


@pytest.mark.parametrize("name", NAMES)
def test_config_mirrors_the_class_and_round_trips(name: str) -> None:
    cls = library.effect_class(name)
    assert (CONF / "effect" / f"{name}.yaml").read_text().startswith(f"# @package effect.{name}\n")
    assert NODES[name]["_target_"] == f"{cls.__module__}.{cls.__qualname__}"
    effect = configured(name)
    placed = {"begun_s", "before_gauge", "behind_gauge", *(f.name for f in cls.gate_fields())}
    own = {k: v for k, v in dataclasses.asdict(effect).items() if k not in placed}
    assert {"_target_": NODES[name]["_target_"], **own} == NODES[name]


@pytest.mark.parametrize("name", LAYERED)
def test_what_changes_the_body_has_no_gate_and_needs_layers(name: str) -> None:
    with pytest.raises(ConfigError, match="neither above_share nor since_s"):
        dataclasses.replace(typical(name), since_s=4.0)
    with pytest.raises(ConfigError, match="needs a body with layers"):
        simulate([typical(name)])
    np.testing.assert_array_equal(library.effect_class(name).neutral().layers(7), np.ones(7))


@pytest.mark.parametrize("name", ["payload", "frame", "delay"])
def test_where_no_pressure_acts_no_gate_asks_for_one(name: str) -> None:
    with pytest.raises(ConfigError, match="no pressure acts there; expected since_s"):
        dataclasses.replace(typical(name), above_share=0.3)


@pytest.mark.parametrize("name", NAMES)
def test_declared_parameters_are_consistent(name: str) -> None:
    cls = library.effect_class(name)
    assert cls.name() == name and cls.title
    for field in cls.parameter_fields():
        data = field.metadata
        assert data["low"] <= data["neutral"] <= data["high"], field.name
        assert data["low"] <= data["typical"] <= data["high"], field.name
        assert not data["log"] or data["low"] > 0.0, field.name
        for bad in (data["low"] - 1.0, data["high"] * 1.5 + 1.0):
            with pytest.raises(ConfigError, match=field.name):
                dataclasses.replace(cls.neutral(), **{field.name: bad})


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", ACTING)
def test_neutral_is_identity(name: str, robot: str) -> None:
    with_neutral = simulate([library.effect_class(name).neutral()], robot=robot)
    bare = simulate([], robot=robot)
    for channel in ("position", "quaternion", "pressure"):
        np.testing.assert_allclose(getattr(with_neutral, channel), getattr(bare, channel), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", [n for n in ACTING if library.effect_class(n).clock is None])
def test_from_a_time_on_nothing_happens_before_and_the_same_at_last(name: str) -> None:
    """A gate that opens at 4 s leaves the motion before it alone; one that opens at once changes nothing."""
    bare, late = simulate([]), simulate([dataclasses.replace(typical(name), since_s=4.0)])
    first = round(4.0 / 0.01) - 1
    always, soon = simulate([typical(name)]), simulate([dataclasses.replace(typical(name), since_s=1e-9)])
    for channel in ("position", "quaternion", "pressure"):
        np.testing.assert_allclose(getattr(late, channel)[:first], getattr(bare, channel)[:first], rtol=0, atol=1e-9)
        np.testing.assert_allclose(getattr(soon, channel)[-100:], getattr(always, channel)[-100:], rtol=0.05, atol=2e-3)
    changed = [np.abs(getattr(late, c)[first:] - getattr(bare, c)[first:]).max() for c in ("position", "pressure")]
    assert max(changed) > 1e-5


@pytest.mark.parametrize("name", [n for n in ACTING if library.effect_class(n).site in ("valve", "chamber", "body")])
def test_above_the_highest_pressure_nothing_happens(name: str) -> None:
    bare, above = simulate([]), simulate([dataclasses.replace(typical(name), above_share=0.95)])
    for channel in ("position", "quaternion", "pressure"):
        np.testing.assert_allclose(getattr(above, channel), getattr(bare, channel), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ACTING)
def test_apply_is_pure_and_keeps_shape(name: str) -> None:
    robot, effect = simulator().robot, typical(name)
    state, value = effect.reset(robot), example_input(effect, robot)
    kept_state, kept_value = state.copy(), value.copy()
    first, second = effect.apply(robot, state, value, 0.01), effect.apply(robot, state, value, 0.01)
    np.testing.assert_array_equal(state, kept_state)
    np.testing.assert_array_equal(value, kept_value)
    for one, other, shape in zip(first, second, (state.shape, value.shape), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.shape == shape and one.dtype == np.float64 and np.isfinite(one).all()


@pytest.mark.parametrize("name", [n for n in ACTING if library.effect_class(n).site in ("body", "load")])
def test_port_changes_its_state_only_on_commit(name: str) -> None:
    robot, effect = simulator().robot, typical(name)
    state, port = effect.reset(robot), example_input(effect, robot)
    kept = state.copy()
    type(effect).kernel(effect.pack(robot), state, port, 0.01, False)
    np.testing.assert_array_equal(state, kept)


@pytest.mark.parametrize("name", ACTING)
def test_same_input_same_output(name: str) -> None:
    np.testing.assert_array_equal(simulate([typical(name)]).position, simulate([typical(name)]).position)


@pytest.mark.parametrize("name", ACTING)
def test_halving_the_step_changes_the_result_in_first_order(name: str) -> None:
    coarse, middle, fine = (simulate([typical(name)], dt).position for dt in (0.01, 0.005, 0.0025))
    first = np.sqrt(np.mean((coarse - middle[1::2]) ** 2))
    second = np.sqrt(np.mean((middle - fine[1::2]) ** 2))
    assert first < 1.5e-3, f"{1e3 * first:.3f} mm between steps of 10 and 5 ms"
    assert second < 0.7 * first, f"{1e6 * first:.2f} um, then {1e6 * second:.2f} um"


VISIBLE = [(n, r) for n in ACTING for r in ROBOTS if (n, r) != ("crosstalk", "single_chamber_finger")]  # no neighbour


@pytest.mark.parametrize(("name", "robot"), VISIBLE)
def test_typical_is_visible(name: str, robot: str) -> None:
    changed, bare = simulate([typical(name)], robot=robot), simulate([], robot=robot)
    assert np.isfinite(changed.position).all()
    if library.effect_class(name).channel == "pressure":
        assert np.abs(changed.pressure - bare.pressure).max() > 0.01 * simulator(robot).robot.pressure_max_pa
        np.testing.assert_array_equal(changed.position, bare.position)
        return
    moved = np.sqrt(np.mean(np.sum((changed.position - bare.position) ** 2, axis=1)))
    assert moved > 2e-3 * simulator(robot).robot.length_m, f"{1e3 * moved:.3f} mm"


BY_CHAMBER = [n for n in NAMES if "chamber" in NODES[n]]


@pytest.mark.parametrize("name", BY_CHAMBER)
def test_one_chamber_can_be_meant(name: str) -> None:
    channel = "pressure" if library.effect_class(name).channel == "pressure" else "position"
    one = getattr(simulate([dataclasses.replace(typical(name), chamber=1)]), channel)
    every = getattr(simulate([typical(name)]), channel)
    bare = getattr(simulate([]), channel)
    assert np.abs(one - bare).max() > 1e-4 and np.abs(one - every).max() > 1e-4
    with pytest.raises(ConfigError, match="chamber=3 does not exist"):
        simulate([dataclasses.replace(typical(name), chamber=3)])


@pytest.mark.parametrize("name", ACTING)
def test_a_run_in_pieces_is_the_run(name: str) -> None:
    """What an effect remembers stands in its state alone: a filter that goes on equals one that never stopped."""
    effect, robot = typical(name), simulator().robot
    if effect.site in ("body", "load"):
        return  # test_stepping_with_hooks_is_simulating
    bare = simulate([])
    rows = np.hstack([bare.position, bare.quaternion]) if effect.channel == "pose" else bare.pressure
    rows = rows if effect.site == "sensor" else bare.pressure
    site = effect.site if effect.channel == "pose" else "gauge"
    whole, pieces = (SignalFilter(chain_of(robot, [effect]), site) for _ in range(2))
    parts = np.array_split(rows, [1, 5, 400])
    if site == "sensor":
        np.testing.assert_array_equal(np.vstack([pieces.advance(part, 0.01) for part in parts]), whole.advance(rows, 0.01))
        return
    again = [pieces.lead(held(part), 0.01) for part in parts]
    for together, split in zip(whole.lead(held(rows), 0.01), zip(*again, strict=True), strict=True):
        np.testing.assert_array_equal(np.vstack(split), together)


@pytest.mark.parametrize("name", ACTING)
def test_approaching_neutral_it_vanishes_continuously(name: str) -> None:
    """Half way to neutral it does less than at its typical values: a search can find the way back."""
    cls = library.effect_class(name)

    def size(share: float) -> float:
        values = {}
        for f in cls.parameter_fields():
            neutral, shown = f.metadata["neutral"], f.metadata["typical"]
            values[f.name] = (
                neutral * (shown / neutral) ** share if f.metadata["log"] else neutral + share * (shown - neutral)
            )
        motion, bare = simulate([cls(**values)]), simulate([])
        return float(
            np.abs(motion.position - bare.position).max() + 1e-6 * np.abs(motion.pressure - bare.pressure).max()
        )

    assert size(0.02) < 0.5 * size(1.0), f"{size(0.02):.3g}, {size(1.0):.3g}"


def test_order_of_the_list_does_not_matter() -> None:
    effects = [
        typical(name) for name in ("delay", "lag", "viscoelasticity", "payload", "mount_tilt", "gain", "hysteresis")
    ]
    np.testing.assert_array_equal(simulate(effects).position, simulate(effects[::-1]).position)


def test_nor_does_it_among_effects_of_one_name() -> None:
    """What a chamber feels of another is felt by a third in turn."""
    both = [library.effect_class("crosstalk")(share=0.3, chamber=chamber) for chamber in (0, 1)]
    pressures = np.array([[1e4, 2e4, 0.0]])
    acting = [chain_of(simulator().robot, order).acting(held(pressures), 0.01) for order in (both, both[::-1])]
    np.testing.assert_array_equal(*acting)


def test_members_within_their_bounds_converge_together() -> None:
    rng = np.random.default_rng(7)
    for _ in range(40):
        chosen = []
        for name in rng.choice(ACTING, 3, replace=False):
            cls = library.effect_class(str(name))
            values = {
                f.name: float(rng.choice([f.metadata["neutral"], f.metadata["typical"], rng.uniform(0.5, 2.0)]))
                for f in cls.parameter_fields()
            }
            bounds = {f.name: (f.metadata["low"], f.metadata["high"]) for f in cls.parameter_fields()}
            chosen.append(cls(**{k: float(np.clip(v, *bounds[k])) for k, v in values.items()}))
        assert np.isfinite(simulate(chosen).position).all(), chosen


@pytest.mark.parametrize("name", [n for n in ACTING if library.effect_class(n).site in ("body", "load")])
def test_stepping_with_hooks_is_simulating(name: str) -> None:
    body = simulator()
    time, pressure = program(body.robot, 0.01, duration_s=2.0)
    chain = chain_of(body.robot, [typical(name)])
    motion = body.simulate(time, pressure, body=chain.hooks("body"), load=chain.hooks("load"))
    on_body, on_load = chain.hooks("body"), chain.hooks("load")
    state = chain.at_rest(body, on_load)
    for row in pressure:
        state = body.step(state, row, 0.01, body=on_body, load=on_load)
    np.testing.assert_allclose(body.observe(state)[0], motion.position[-1], atol=1e-8)


@pytest.mark.parametrize("highest", [0.0, -1e3])
def test_a_robot_under_suction_alone_has_every_effect_in_shares_of_its_suction(highest: float) -> None:
    vacuum = dataclasses.replace(simulator().robot, pressure_min_pa=-5e3, pressure_max_pa=highest)
    both = dataclasses.replace(vacuum, pressure_max_pa=5e3)
    for name in ACTING:
        if name != "supply_limit":  # its ceiling is of the highest pressure: here there is none
            np.testing.assert_array_equal(typical(name).pack(vacuum), typical(name).pack(both), err_msg=name)
    assert library.effect_class("supply_limit")(ceiling=0.6, floor=0.5).pack(vacuum).tolist() == [np.inf, -2.5e3, -1.0]
    late = library.effect_class("gain")(gain=0.5, since_s=1.0, over_s=0.1)
    seen = SignalFilter(chain_of(vacuum, [late]), "valve", "chamber").advance(np.full((200, 3), -4e3), 0.01)
    np.testing.assert_allclose(seen[[50, 150]], np.tile([[-4e3], [-2e3]], 3))
