"""A rival takes an effect's place where all runs that no fit saw agree on it for sure."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, effect_axes, starts
from softrl.diagnosis.fitting.judge import Gap, Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging import examine
from softrl.diagnosis.judging.examine import in_full
from softrl.diagnosis.judging.rivalry import as_good, overtakes
from softrl.diagnosis.judging.rivals import Rival, overtaking, plainer, simpler, stand_in, suddenly
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

MATERIAL = 1.0


@pytest.fixture(scope="module")
def judges(body: PccSimulator) -> tuple[Judge, Judge]:
    """Judge on the held-out runs, and on all."""
    config, runs = configured(), made(body, sessions=4).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    both = Judge(problem, 1.0, MATERIAL / config.thresholds.material_share, config.thresholds, 0)
    return both.on(runs[2:]), both


def trial(judges: tuple[Judge, Judge], name: str, inside: float, heldout: float) -> Any:
    """Return a trial with errors of equal size in all bins, but for noise that every trial shares."""
    judge, both = judges
    count = len(judge.problem.run_of_bin)
    noise = np.random.default_rng(0).chisquare(3, len(both.problem.run_of_bin))
    squares = noise + np.r_[np.full(len(noise) - count, inside), np.full(count, heldout)]
    hypothesis = Hypothesis((Choice(name),), ())
    fit = SimpleNamespace(point=np.zeros(1))
    return SimpleNamespace(hypothesis=hypothesis, everywhere=squares, squares=squares[-count:], fit=fit)


def test_the_best_of_those_that_are_better_takes_the_place() -> None:
    def rival(name: str, value: float, sure: bool) -> Rival:
        fit: Any = None
        return Rival(Choice("mullins"), Choice(name), Gap(value, value - 0.1, value + 0.1), True, fit, sure)

    ahead = overtaking([rival("lag", -1.0, True), rival("leak", -2.0, True), rival("play", -3.0, False)])
    assert ahead is not None and ahead.choice.name == "leak"
    assert overtaking([rival("play", -3.0, False)]) is None


@pytest.mark.parametrize(
    ("name", "inside", "heldout", "taken"),
    [
        ("frame", 4.0, 4.0, True),
        ("frame", 4.0, 5.1, False),  # held out it is worse
        ("frame", 6.1, 4.0, False),  # as much worse where the fits were left out in turn
        ("frame", 4.9, 4.9, True),  # by little, but for sure
        ("command_map", 4.9, 4.9, False),  # a map bends to anything: what it removes has to count
        ("command_map", 0.5, 0.5, True),
    ],
)
def test_a_rival_is_better_where_all_runs_agree(
    judges: tuple[Judge, Judge], name: str, inside: float, heldout: float, taken: bool
) -> None:
    final = trial(judges, "mount_tilt", 5.0, 5.0)
    assert overtakes(*judges, trial(judges, name, inside, heldout), final) == taken


@pytest.mark.parametrize(("heldout", "taken"), [(4.9, False), (0.5, True)])
def test_a_rival_with_more_numbers_has_to_remove_what_counts(judges: tuple[Judge, Judge], heldout: float, taken: bool) -> None:
    final, rival = trial(judges, "stiffness_scale", 5.0, 5.0), trial(judges, "drift", heldout, heldout)
    rival.fit.point = np.zeros(3)
    assert overtakes(*judges, rival, final) == taken


@pytest.mark.parametrize(
    ("inside", "heldout", "alike"),
    [(5.0, 5.0, True), (9.0, 5.0, True), (9.0, 9.0, False)],  # the second is worse where fits see it alone
)
def test_a_rival_that_may_be_better_held_out_is_as_good(
    judges: tuple[Judge, Judge], inside: float, heldout: float, alike: bool
) -> None:
    final = trial(judges, "frame", 5.0, 5.0)
    assert as_good(*judges, trial(judges, "base_tilt", inside, heldout), final) == alike


@pytest.mark.parametrize("only", [True, False])
@pytest.mark.parametrize(("without", "named"), [(5.5, False), (6.15, False), (20.0, True)])  # 6.15 counts, more stays
def test_what_is_named_stands_out_held_out_too(
    judges: tuple[Judge, Judge], monkeypatch: pytest.MonkeyPatch, without: float, named: bool, only: bool
) -> None:
    monkeypatch.setattr(examine, "implausible", lambda *_: False)
    judge, less, final = judges[0], trial(judges, "lag", without, without), trial(judges, "lag", 5.0, 5.0)
    gap = judge.gap(less.squares, final.squares)
    assert (judge.removed(less.squares, final.squares) > judge.material) == (without > 6.0)
    assert examine._holds(judge, less, final, gap, only) == named


def test_another_chamber_contests_what_is_named_of_one(judges: tuple[Judge, Judge]) -> None:
    gap = Gap(0.0, -0.1, 0.1)
    for other, contests in ((Choice("gain", 2), True), (Choice("gain"), False), (Choice("knee", 1), True)):
        assert Rival(Choice("gain", 1), other, gap, True, begun(other, 0.0), False).contests == contests
        assert not Rival(Choice("gain", 1), other, gap, False, begun(other, 0.0), False).contests


def test_what_pays_stands_in_for_what_does_not(judges: tuple[Judge, Judge]) -> None:
    judge = judges[0]
    without = trial(judges, "lag", 9.0, 9.0)

    def rival(name: str, heldout: float) -> Rival:
        gap = Gap(heldout, heldout, heldout)
        return Rival(Choice("mullins"), Choice(name), gap, True, trial(judges, name, heldout, heldout), False)

    found = stand_in(judge, without, [rival("leak", 8.0), rival("play", 0.5), rival("drift", 0.4)])
    assert found is not None and found.choice.name == "drift"
    assert stand_in(judge, without, [rival("leak", 8.0)]) is None


@pytest.mark.parametrize(
    ("named", "name", "heldout", "taken"),
    [
        ("knee", "supply_limit", 5.5, True),
        ("knee", "supply_limit", 6.5, False),  # a slope that counts
        ("knee", "leak", 5.0, False),  # another law, however alike
        ("supply_limit", "knee", 5.0, False),
        ("flow_limit", "lag", 5.5, True),  # hardly ever bounded
        ("flow_limit", "lag", 6.5, False),
    ],
)
def test_the_law_that_is_extended_in_vain_takes_the_place(
    judges: tuple[Judge, Judge], named: str, name: str, heldout: float, taken: bool
) -> None:
    final, other = trial(judges, named, 5.0, 5.0), trial(judges, name, heldout, heldout)
    rival = Rival(Choice(named), Choice(name), Gap(0.0, -0.1, 0.1), True, other, False)
    assert (plainer(judges[0], [rival], final) is rival) == taken


@pytest.mark.parametrize(
    ("named", "rival", "contests"),
    [
        (Choice("failure", 1), Choice("gain", 1, gate=Gate("since_s", 5.0)), False),
        (Choice("failure", 1), Choice("gain", 1), True),
        (Choice("failure", 1), Choice("gain", 0, gate=Gate("since_s", 5.0)), True),
        (Choice("failure", 1), Choice("leak", 1, gate=Gate("since_s", 5.0)), True),
        (Choice("lag"), Choice("rate_limit"), False),
        (Choice("rate_limit"), Choice("lag"), True),
    ],
)
def test_what_is_the_same_by_another_name_contests_nothing(named: Choice, rival: Choice, contests: bool) -> None:
    """A failure is a gain that begins at once; one that begins slowly says something else."""
    other = Rival(named, rival, Gap(0.0, -0.1, 0.1), True, begun(rival, 0.06), False)
    assert other.contests == contests
    assert other._replace(trial=begun(rival, 8.0)).contests == (contests or rival.gate is not None)


@pytest.mark.parametrize(("ratio", "contests"), [(1.5, False), (1.0, False), (0.6, True)])
def test_a_tube_that_does_not_swing_contests_no_lag(ratio: float, contests: bool) -> None:
    """It is two lags in a row, of which rows show one."""
    tube = Choice("tube_line")
    line = begun(tube, ratio, "damping_ratio")
    assert Rival(Choice("lag"), tube, Gap(0.0, -0.1, 0.1), True, line, False).contests == contests
    assert Rival(Choice("dead_time"), tube, Gap(0.0, -0.1, 0.1), True, line, False).contests


def begun(choice: Choice, value: float, name: str = "over_s") -> Any:
    axes, point = effect_axes(choice), starts(choice)[0]
    for k, axis in enumerate(axes):
        point[k] = axis.scaled(value) if axis.name == name else point[k]
    return SimpleNamespace(hypothesis=Hypothesis((choice,), ()), fit=SimpleNamespace(point=point))


@pytest.mark.parametrize(("over_s", "alike", "taken"), [(0.06, True, True), (0.06, False, False), (3.0, True, False)])
def test_a_camera_takes_the_place_of_a_mount_that_leant_over_at_once(over_s: float, alike: bool, taken: bool) -> None:
    forms = (Choice(name, gate=Gate("since_s", 5.0)) for name in ("mount_tilt", "frame", "base_tilt"))
    mount, camera, base = (begun(form, over_s) for form in forms)
    named, gap = mount.hypothesis.effects[0], Gap(0.0, -0.1, 0.1)
    rivals = [Rival(named, t.hypothesis.effects[0], gap, alike, t, False) for t in (base, camera)]
    assert (suddenly(rivals, mount) is rivals[1]) == taken
    assert suddenly(rivals, camera) is None


@pytest.mark.parametrize(
    ("redated", "alike", "numbers", "taken"),
    [
        (True, True, 2, True),
        (False, True, 2, False),  # what fits have seen begin, they have weighed
        (True, False, 2, False),
        (True, True, 3, False),
    ],
)
def test_what_held_out_runs_date_gives_way_to_what_needs_fewer_numbers(
    judges: tuple[Judge, Judge], redated: bool, alike: bool, numbers: int, taken: bool
) -> None:
    final, other = trial(judges, "gain", 5.0, 5.0), trial(judges, "failure", 5.0, 4.9)
    final.fit.point, other.fit.point, named = np.zeros(3), np.zeros(numbers), Choice("gain")
    rival = Rival(named, Choice("failure"), Gap(0.0, -0.1, 0.1), alike, other, False)
    assert (simpler([rival], final, [named] * redated) is rival) == taken


def test_in_full_an_effect_does_what_it_did_before() -> None:
    tilt, lag = Choice("mount_tilt", pinned=("about_x_rad",)), Choice("lag")
    hypothesis = Hypothesis((lag, tilt), ("mass_scale",))
    point = np.r_[starts(lag)[0], 0.4, 0.1]
    final: Any = SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(point=point))
    whole, [start] = in_full(final, tilt)
    assert whole == Hypothesis((lag, Choice("mount_tilt")), ("mass_scale",))
    np.testing.assert_array_equal(start, np.r_[starts(lag)[0], 0.0, 0.4, 0.1])


def test_what_is_better_by_chance_takes_no_place(judges: tuple[Judge, Judge]) -> None:
    judge, both = judges
    rng, size, count = np.random.default_rng(1), len(both.problem.run_of_bin), len(judge.problem.run_of_bin)
    taken = 0
    for _ in range(100):
        one, other = (trial(judges, name, 0.0, 0.0) for name in ("mount_tilt", "frame"))
        other.everywhere = other.everywhere + 0.3 * rng.standard_normal(size)
        other.squares = other.everywhere[-count:]
        taken += overtakes(judge, both, other, one)
    assert taken <= 5, "each of the two sets says so by chance in 5 of 100, both together in fewer"
