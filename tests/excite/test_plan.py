"""Laws of planning: what adds up, what refitting absorbs, and what a program may never do."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

from softrl.artifacts.diagnosis import Diagnosis
from softrl.artifacts.excitation import Excitation
from softrl.core.config import build
from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.effects.dead_time import DeadTime
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.library import effect_class
from softrl.excite.block import HIGHEST_HZ, blocks
from softrl.excite.plan import Effort, pairs_of, plan, pursued, refitted_separation, score, separation, sums
from softrl.excite.rival import Rival, parse, rivals_of, typical
from softrl.excite.separation import Normal, Sensing, normal, refitted, responses, tangent
from softrl.excite.stage import SETTLED_SIGMA, Config, csv_text, run, usual_program, write_commands, write_out
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.read import read
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"
SENSING = Sensing(dt_s=0.05, sample_s=0.1, position_noise_m=1e-4, pressure_noise_pa=None)
EFFORT = Effort(shortlist=2, exchanges=1, repeats=2, proposals=3, fit_evaluations=8)


def node(path: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((CONF / path).read_text())
    return {key: value for key, value in found.items() if key != "_target_"}


@cache
def robot(name: str = "tripod") -> Robot:
    return build(node(f"robot/{name}.yaml"), Robot, "robot")


@cache
def body(name: str = "tripod") -> PccSimulator:
    return PccSimulator(robot=robot(name), **node("simulator/pcc.yaml"))


def rival(text: str) -> Rival:
    return Rival(text, robot(), body(), parse(text, robot()), 4.0)


def config(**changed: Any) -> Config:
    base = OmegaConf.merge(
        node("stage/excite.yaml"), node("profile/tiny/excite.yaml"), {"seed": 0, "out": None}, changed
    )
    return build(OmegaConf.to_container(base), Config, "stage")


def wave(seconds: float = 10.0) -> np.ndarray:
    time = SENSING.dt_s * np.arange(1, round(seconds / SENSING.dt_s) + 1)
    return 2e4 * np.sin(np.outer(time, [2.0, 1.3, 0.7])) ** 2


def test_tangent_is_the_derivative() -> None:
    lag = rival("lag")
    space = tangent(lag, lag.point, wave(), SENSING)
    for k in range(len(lag.point)):
        nudge = 2e-3 * np.eye(len(lag.point))[k]
        up, down = responses([lag.at(lag.point + nudge), lag.at(lag.point - nudge)], wave(), SENSING)
        central = (up - down) / 4e-3
        scale = np.abs(central).max()
        np.testing.assert_allclose(space.jacobian[:, k], central, atol=0.05 * scale)


def test_sums_of_programs_add_up_and_more_rows_never_bring_rivals_closer() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(40, 4)), rng.normal(size=(60, 4))
    gaps = rng.normal(size=40), rng.normal(size=60)

    def of(jacobian: np.ndarray, gap: np.ndarray) -> Normal:
        return Normal(float(gap @ gap), jacobian.T @ gap, jacobian.T @ jacobian)

    together = of(np.vstack([first, second]), np.concatenate(gaps))
    added = of(first, gaps[0]) + of(second, gaps[1])
    np.testing.assert_allclose(added.distance(), together.distance(), rtol=1e-12)
    assert together.distance() > max(of(first, gaps[0]).distance(), of(second, gaps[1]).distance())
    # what lies in the tangent space is refitted away, but for the unit of noise that a parameter's move costs
    inside = of(first, first @ np.array([0.5, -0.2, 0.1, 0.3]))
    assert inside.distance() < 1.0 < np.sqrt(inside.square)


def test_a_hypothesis_finds_itself() -> None:
    lag = rival("lag")
    target = responses([lag.at(lag.point)], wave(), SENSING)[0]
    start = lag.point + np.array([0.3, -0.3, 0.2, 0.0, 0.0, 0.1])
    point, left = refitted(lag, start, target, wave(), SENSING, 20)
    np.testing.assert_allclose(point[:2], lag.point[:2], atol=0.02)
    assert left < 0.02 * np.linalg.norm(responses([lag.at(start)], wave(), SENSING)[0] - target)


def test_a_dead_time_within_a_row_is_how_a_log_may_be_written() -> None:
    """A diagnosis tunes how late rows act: no program tells less than a row from that."""
    short = Rival("short", robot(), body(), (DeadTime(delay_s=0.01),), 4.0)
    target = responses([short.at(short.point)], wave(), SENSING)[0]
    left = []
    for late_s in (0.0, 0.02):
        still = replace(rival("nothing"), late_max_s=late_s)
        left.append(refitted(still, still.point, target, wave(), SENSING, 12)[1])
    assert left[1] < 0.1 * left[0], left
    named = [axis.name for axis in replace(rival("dead_time"), late_max_s=0.02).axes]
    assert "late_s" not in named and "delay_s" in named


def test_a_retuned_body_absorbs_what_it_can() -> None:
    """A stiffer wall is the simulator's own parameter: no program separates it from a retuned simulator."""
    pairs = pairs_of([rival("stiffness_scale"), rival("nothing")], wave(), SENSING, EFFORT)
    seen = pairs[0].ways[0]
    target, bare = responses(
        [seen.truth.at(seen.at_truth), rival("nothing").at(rival("nothing").point)], wave(), SENSING
    )
    assert refitted_separation(pairs[0], wave(), SENSING) < 0.05 * np.linalg.norm(target - bare)


def test_more_noise_brings_rivals_closer_in_proportion() -> None:
    pair = pairs_of([rival("lag"), rival("hysteresis")], wave(), SENSING, EFFORT)[0]
    loud = replace(SENSING, position_noise_m=3e-4)
    quiet, noisy = (separation(sums(pair, wave(), s)) for s in (SENSING, loud))
    np.testing.assert_allclose(quiet / noisy, 3.0, rtol=0.05)


@pytest.mark.parametrize("name", ["tripod", "single_chamber_finger"])
def test_blocks_begin_and_end_at_rest_within_the_limits(name: str) -> None:
    mine, dt_s = robot(name), 0.02
    for block in blocks(mine, dt_s, 2.0, 0):
        pressure = block.pressure
        assert pressure.shape[1] == mine.chambers and not pressure[-1].any(), block.label
        assert mine.pressure_min_pa - 1e-6 <= pressure.min() and pressure.max() <= mine.pressure_max_pa + 1e-6
        steps = np.diff(pressure, axis=0, prepend=np.zeros((1, mine.chambers)))
        assert np.abs(steps).max() <= mine.slew_pa_per_s * dt_s * (1 + 1e-9), block.label


@pytest.mark.parametrize("dt_s", [0.005, 0.01, 0.02, 0.03, 0.1])
def test_the_usual_program_keeps_the_slew_at_any_step(dt_s: float) -> None:
    usual = usual_program(robot(), config().usual, dt_s, round(200.0 / dt_s), 0)
    assert len(usual) == round(200.0 / dt_s) and usual.max() > 0.9 * robot().pressure_max_pa
    assert np.abs(np.diff(usual, axis=0)).max() <= robot().slew_pa_per_s * dt_s * (1 + 1e-9)


def test_blocks_too_quick_for_their_steps_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    whole = {block.label for block in blocks(robot(), 0.05, 1.0, 0)}
    assert set(HIGHEST_HZ) <= {label.partition(",")[0] for label in whole}, "what has a highest tone is a block"
    assert not caplog.text
    assert whole - {block.label for block in blocks(robot(), 0.1, 1.0, 0)} == {"fast multisine"}
    assert "steps of 0.1 s and left out of the plan: fast multisine (below 0.1 s)" in caplog.text
    slow = blocks(robot(), 1.0, 1.0, 0)
    assert len(slow) < len(whole) and all(block.pressure.any() for block in slow if "rest" not in block.label)


def test_no_program_is_planned_for_suction_alone() -> None:
    with pytest.raises(ConfigError, match=r"robot.pressure_max_pa=0: programs are planned of pressures above 0 only"):
        blocks(replace(robot(), pressure_min_pa=-4e4, pressure_max_pa=0.0), 0.05, 1.0, 0)


def test_the_plan_keeps_the_budget_and_beats_each_single_block() -> None:
    pair = pairs_of([rival("hysteresis"), rival("viscoelasticity")], wave(), SENSING, EFFORT)
    candidates = [b for b in blocks(robot(), SENSING.dt_s, 1.0, 0) if len(b.pressure) * SENSING.dt_s < 20.0][:12]
    chosen = plan(pair, candidates, SENSING, 40.0, EFFORT)
    assert chosen and sum(len(b.pressure) for b in chosen) * SENSING.dt_s <= 40.0 + 1e-9
    assert max(chosen.count(b) for b in chosen) <= EFFORT.repeats
    assert [b.label for b in plan(pair, candidates, SENSING, 40.0, EFFORT)] == [b.label for b in chosen]
    together = score([separation(sums(p, np.vstack([b.pressure for b in chosen]), SENSING)) for p in pair])
    alone = [score([separation(sums(p, b.pressure, SENSING)) for p in pair]) for b in candidates]
    assert together > max(alone)


@pytest.mark.parametrize("less", [-0.4, 0.0, 0.4])
def test_a_budget_of_as_many_steps_as_a_block_holds_it(less: float) -> None:
    pair = pairs_of([rival("lag"), rival("nothing")], wave(), SENSING, EFFORT)
    shortest = min(blocks(robot(), SENSING.dt_s, 1.0, 0), key=lambda block: len(block.pressure))
    budget_s = SENSING.dt_s * (3 * len(shortest.pressure) - less)
    chosen = plan(pair, [shortest], SENSING, budget_s, replace(EFFORT, repeats=5))
    assert len(chosen) == 3


def test_the_stage_writes_a_program_that_reads_back(tmp_path: Path) -> None:
    tracker = NullTracker()
    settings = config(hypotheses=["lag", "dead_time"], out=str(tmp_path / "plan"))
    planned = run(settings, robot(), body(), None, tracker=tracker)
    again = run(settings, robot(), body(), None, tracker=NullTracker())
    for _ in range(2):
        write_out(settings, robot(), planned)
    np.testing.assert_array_equal(planned.pressure, again.pressure)
    assert planned.time[-1] <= 60.0 * settings.minutes + 1e-9
    apart = planned.pairs[0]["separation_sigma"]
    assert apart["planned"] >= max(apart["default"], apart["random"])
    assert tracker.metrics["separation_lag_dead_time_sigma"] == apart["planned"]
    assert tracker.metrics["default/separation_lag_dead_time_sigma"] == apart["default"]
    written = read(tmp_path / "plan", robot())
    assert len(written.recordings) == settings.runs
    np.testing.assert_allclose(written.recordings[0].pressure_cmd, planned.pressure, atol=1e-4)
    (tmp_path / "plan" / "excite_1.csv").write_text("time_s,p1_cmd_kpa,tip_x_mm\n")
    with pytest.raises(ConfigError, match="holds more than commands"):
        write_out(settings, robot(), planned)
    planned.save(tmp_path / "excitation")
    np.testing.assert_array_equal(Excitation.load(tmp_path / "excitation").pressure, planned.pressure)
    header, first, *_ = csv_text(robot(), planned).splitlines()
    assert header == "time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa"
    np.testing.assert_allclose([float(v) for v in first.split(",")[1:]], 1e-3 * planned.pressure[0], atol=1e-6)


def test_a_robot_is_sent_its_own_command(tmp_path: Path) -> None:
    """A pump that takes a duty cycle is told duty cycles, and the reader makes of them the pressures that were planned."""
    finger, duty = robot("single_chamber_finger"), 100.0 * np.array([0.0, 120.0, -60.0])[:, None]
    planned = Excitation(finger.name, np.array([0.05, 0.10, 0.15]), duty, [], [])
    assert csv_text(finger, planned).splitlines() == ["time_s,pump_pwm_cmd", "0.05,0", "0.1,120", "0.15,-60"]
    for _ in range(2):
        write_commands(tmp_path, finger, planned, 2)
    assert (tmp_path / "excite_2.csv").read_text().splitlines()[:2] == ["time_s,pump_pwm_cmd", "0.05,0"]
    for recording in read(tmp_path, finger).recordings:
        np.testing.assert_allclose(recording.pressure_cmd, duty)


def test_what_is_reported_is_what_refits_leave_at_their_end(caplog: pytest.LogCaptureFixture) -> None:
    """A search that is cut short leaves rivals farther apart than they are: 14 sigma where 0.4 are left."""
    caplog.set_level("INFO", "softrl.excite")
    settings = config(hypotheses=["lag", "rate_limit"])
    planned = run(settings, robot(), body(), None, tracker=NullTracker())
    apart, noise = planned.pairs[0]["separation_sigma"], settings.sensing
    sensing = Sensing(noise.dt_s, noise.sample_s, 1e-3 * noise.position_mm, None)
    rivals = rivals_of(settings.hypotheses, None, robot(), body(), settings.tuned_factor, settings.size, noise.dt_s)
    usual = usual_program(robot(), settings.usual, noise.dt_s, round(60.0 * settings.minutes / noise.dt_s), 0)
    ways = pairs_of(rivals, usual, sensing, settings.effort)[0].ways
    ended = min(pursued(way, planned.pressure, sensing, 300)[1] for way in ways)
    assert apart["planned"] == pytest.approx(ended, rel=0.02) and apart["planned"] >= apart["default"]
    assert ("no program found tells them apart" in caplog.text) == (ended < SETTLED_SIGMA)


def test_a_diagnosis_names_what_is_to_be_told_apart() -> None:
    found = Diagnosis(
        robot_name="tripod", simulator_name="PccSimulator", verdict="indistinguishable", sentences=[],
        effects=[{"name": "hysteresis", "chamber": -1, "parameters": {
            "height": {"value": 0.05, "low": 0.04, "high": 0.06, "unit": "1"},
            "yield_strain": {"value": 0.03, "low": 0.02, "high": 0.04, "unit": "1"}}}],
        simulator_parameters={"mass_scale": 1.2}, retuned={},
        rivals=[{"name": "friction (chamber 2)", "instead_of": "hysteresis", "equivalent": True},
                {"name": "lag", "instead_of": "hysteresis", "equivalent": False}],
        located=[], errors_mm={}, errors_deg={}, unexplained={}, next_experiment=None, data={},
    )  # fmt: skip
    rivals = rivals_of((), found, robot(), body(), 4.0)
    assert [r.label for r in rivals] == ["hysteresis", "friction (chamber 2)"]
    assert rivals[0].effects == (Hysteresis(0.05, 0.03),) and rivals[1].effects[0].chamber == 1
    assert rivals[0].simulator.mass_scale == 1.2
    with pytest.raises(ConfigError, match="leaves no two hypotheses open"):
        rivals_of((), replace(found, rivals=[]), robot(), body(), 4.0)


def test_hypotheses_are_read_as_people_write_them() -> None:
    assert parse("nothing", robot()) == ()
    both = parse("lag + gain@2", robot(), size=0.5)
    assert both[0] == Lag(0.15, 0.15) and (both[1].gain, both[1].chamber) == (pytest.approx(0.9), 1)
    for wrong, said in (
        ("lagg", "unknown"),
        ("gain@4", "chambers 1..3"),
        ("payload@1", "alone"),
        ("la-g", "cannot be read"),
    ):
        with pytest.raises(ConfigError, match=said):
            parse(wrong, robot())
    finger = robot("single_chamber_finger")
    for idle, said in (("crosstalk", f"no sense for robot {finger.name}"), ("thermal_softening", "follows the temperature")):
        with pytest.raises(ConfigError, match=rf"stage.hypotheses: '{idle}' would do nothing here: it .*{said}"):
            parse(f"lag+{idle}", finger)
    for listed, said in ((["lag"], "two or more"), (["lag", "lag"], "two or more"), ([], "no diagnosis")):
        with pytest.raises(ConfigError, match=said):
            run(config(hypotheses=listed), robot(), body(), None, tracker=NullTracker())
    with pytest.raises(ConfigError, match="too short"):
        run(config(hypotheses=["lag", "leak"], minutes=0.01), robot(), body(), None, tracker=NullTracker())


def test_size_scales_strengths_and_leaves_shapes() -> None:
    """Rates that limit are strengths, the smaller the stronger; how a play is spread says nothing of how much it is."""
    for name, rate in (("shared_flow", "rise_per_s"), ("rate_limit", "fall_per_s"), ("pi_regulator", "integral_s")):
        small, whole, large = (getattr(typical(name, robot(), size), rate) for size in (0.5, 1.0, 2.0))
        assert (small, large) == (pytest.approx(2.0 * whole), pytest.approx(0.5 * whole)), name
    for name, shape, strength in (("play", "spread", "height"), ("tube_line", "damping_ratio", "period_s")):
        whole, large = (typical(name, robot(), size) for size in (1.0, 3.0))
        assert getattr(large, shape) == getattr(whole, shape), name
        assert getattr(large, strength) == pytest.approx(3.0 * getattr(whole, strength)), name
    for name in ("viscoelasticity", "leak", "hysteresis"):
        slow = {f.name for f in effect_class(name).parameter_fields() if f.metadata["log"]}
        assert all(getattr(typical(name, robot(), 0.5), f) == getattr(typical(name, robot()), f) for f in slow), name
    with pytest.raises(ConfigError, match=r"stage.size=20 makes gain.gain=-3, outside 0.1..3; expected a smaller size"):
        typical("gain", robot(), 20.0)


def test_normal_of_a_truth_is_its_gap_to_the_rival() -> None:
    lag = rival("lag")
    space = tangent(lag, lag.point, wave(), SENSING)
    assert normal(space.response, space).distance() == 0.0


@pytest.mark.parametrize(
    ("changed", "told"),
    [({"effort": {"repeats": 0}}, "effort.repeats=0; expected 1 or more"),
     ({"sensing": {"pressure_kpa": 0.0}}, "pressure_kpa=0.0; expected positive numbers, or null"),
     ({"sensing": {"dt_s": 0.2}}, r"sensing\.dt_s=0.2 is too long: stage\.usual\.multisine_band_hz=.* tones below 2.5 Hz"),
     ({"usual": {"multisine_share": 1.1}}, r"stage\.usual\.multisine_share=1.1; expected a share")],
)  # fmt: skip
def test_what_no_search_can_work_with_is_refused_at_once(changed: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        config(**changed)
