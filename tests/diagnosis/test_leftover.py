"""What is left beside effects that explain most of an error: no reason where it is noise, one where it is structure."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Residual
from softrl.diagnosis.judging import leftover
from softrl.diagnosis.judging.leftover import Explained, pieces_of_course, reasons_of
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured


@pytest.mark.parametrize(
    ("name", "of_all", "left", "uneven", "unknown"),
    [
        ("frame", 0.8, 3.0, True, True),
        ("command_map", 0.8, 3.0, True, True),
        ("frame", 0.95, 3.0, True, False),
        ("frame", 0.8, 3.0, False, False),
        ("frame", 0.8, 2.0, True, False),
        ("mullins", 0.8, 3.0, True, False),  # a wall's law may have another form
        ("mullins", 0.7, 3.0, True, True),
    ],
)
def test_structure_that_is_plainly_left_is_told_unless_nearly_all_is_explained(
    name: str, of_all: float, left: float, uneven: bool, unknown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge: Any = SimpleNamespace(
        material=1.0, travel=200.0, thresholds=SimpleNamespace(explained_share=0.75), excess=np.sqrt
    )
    offer: Any = SimpleNamespace(pays=False, fitted=left**2)
    final: Any = SimpleNamespace(hypothesis=Hypothesis((Choice(name),), ()), squares=None)
    for own, value in (("_drives", []), ("heldout_residual", None), ("_uneven", uneven)):
        monkeypatch.setattr(leftover, own, lambda *_, value=value: value)
    assert bool(reasons_of(judge, final, offer, Explained(0.9, of_all, left))) is unknown


@pytest.mark.parametrize(("fitted", "left", "unknown"), [(1.0, 4.0, True), (2.0, 4.0, False), (0.1, 2.0, False)])
def test_what_holds_for_the_runs_of_the_fit_alone_is_not_understood(
    fitted: float, left: float, unknown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge: Any = SimpleNamespace(
        material=1.0, travel=200.0, thresholds=SimpleNamespace(explained_share=0.75), excess=np.sqrt
    )
    monkeypatch.setattr(leftover, "_drives", lambda *_: [])
    monkeypatch.setattr(leftover, "heldout_residual", lambda *_: None)
    final: Any = SimpleNamespace(hypothesis=Hypothesis((Choice("rate_limit"),), ()), squares=None)
    offer: Any = SimpleNamespace(pays=False, fitted=fitted**2)
    reasons = reasons_of(judge, final, offer, Explained(0.9, 0.9, left))
    assert bool(reasons) is unknown
    assert not unknown or "4.0 times as large on runs that no fit saw" in reasons[0]


def test_rare_jumps_are_no_noise_however_white_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    quiet = rng.standard_normal((400, 3))
    jumps = 8.0 * rng.standard_normal((400, 3)) * (rng.random((400, 1)) < 0.03)
    judge: Any = SimpleNamespace(problem=None, material=0.3, seed=1, rms=lambda squares: float(np.sqrt(np.mean(squares))))
    drives = [rng.standard_normal((400, 2)).cumsum(axis=0)]
    monkeypatch.setattr(leftover, "slopes", lambda *_: ())
    for run, uneven in ((quiet, False), (quiet + jumps, True)):
        residual = Residual([run], {})
        assert leftover._uneven(judge, None, residual, drives, leftover.UNEVEN_FACTOR) is uneven  # type: ignore[arg-type]


@pytest.mark.parametrize("hidden", [False, True])  # parameters that take up jumps leave some of them everywhere
@pytest.mark.parametrize(("seed", "kind"), [(s, kind) for s in range(4) for kind in ("sticks", "noise", "body")])
def test_a_valve_that_sticks_for_moments_is_unknown_and_noise_of_as_much_error_is_not(
    seed: int, kind: str, hidden: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    drives = [np.cumsum(0.02 * rng.standard_normal((300, 3)), axis=0) for _ in range(2)]
    runs = [lfilter([1.0], [1.0, -0.6], rng.standard_normal((300, 3)), axis=0) for _ in drives]
    if kind == "sticks":  # for a second at a time one chamber stays where it is
        for run, drive in zip(runs, drives, strict=True):
            for first in rng.integers(0, 280, 5):
                held = slice(first, first + 10)
                run[held] += 300.0 * (drive[held] - drive[first])[:, :1] * rng.standard_normal(3)
    elif kind == "body":  # a detail that comes with every motion
        runs = [run + 6.0 * drive**2 for run, drive in zip(runs, drives, strict=True)]
    residual = Residual(runs, {})
    rms = float(np.sqrt(residual.squares.mean()))
    left = 2.6  # times what counts, of which little is below the noise
    judge: Any = SimpleNamespace(
        problem=None, material=rms / left, travel=200.0 * rms / left, seed=seed, floor=np.inf,
        thresholds=SimpleNamespace(explained_share=0.75),
        rms=lambda squares: float(np.sqrt(np.mean(squares))), excess=np.sqrt,
    )  # fmt: skip
    for own, value in (("_drives", drives), ("heldout_residual", residual), ("slopes", ()), ("_changing", 0.0)):
        monkeypatch.setattr(leftover, own, lambda *_, value=value: value)
    if hidden:
        monkeypatch.setattr(leftover, "_uneven", lambda *_: False)
    final: Any = SimpleNamespace(hypothesis=Hypothesis((), ()), squares=residual.squares)
    reasons = reasons_of(judge, final, SimpleNamespace(pays=False, fitted=rms**2), Explained(0.0, 0.0, rms))  # type: ignore[arg-type]
    assert bool(reasons) is (kind == "sticks")


@pytest.mark.parametrize(
    ("of_all", "left", "told"), [(0.6, 25.0, True), (0.6, 15.0, False), (0.9, 45.0, False), (0.9, 55.0, True)]
)
def test_what_is_left_is_no_noise_where_it_is_loud_beside_the_motion(
    monkeypatch: pytest.MonkeyPatch, of_all: float, left: float, told: bool
) -> None:
    """Whatever a map without physics makes of it: a tenth of the motion, a quarter beside what explains most of it."""
    monkeypatch.setattr(leftover, "_uneven", lambda *_: False)
    monkeypatch.setattr(leftover, "_drives", lambda _: [])
    monkeypatch.setattr(leftover, "heldout_residual", lambda *_: None)
    thresholds = SimpleNamespace(explained_share=0.75)
    judge: Any = SimpleNamespace(material=1.0, travel=200.0, excess=np.sqrt, thresholds=thresholds)
    final: Any = SimpleNamespace(hypothesis=Hypothesis((Choice("tube_line"),), ()), squares=None)
    offer: Any = SimpleNamespace(pays=False, fitted=left**2)
    reasons = reasons_of(judge, final, offer, Explained(0.98, of_all, left))
    assert bool(reasons) is told and all("of the motion" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("effects", "pieces"),
    [
        ([Choice("drift"), Choice("failure"), Choice("gain", 0)], ["drift", "failure"]),
        ([Choice("drift"), Choice("failure", 1)], ["drift", "failure (chamber 2)"]),
        ([Choice("drift", 1), Choice("failure", 1)], ["drift (chamber 2)", "failure (chamber 2)"]),
        ([Choice("drift", 0), Choice("failure", 1)], []),  # two chambers, two misfortunes
        ([Choice("drift"), Choice("viscoelasticity")], []),
        ([Choice("failure")], []),
    ],
)
def test_steps_and_ramps_of_one_place_are_no_law_together(effects: list[Choice], pieces: list[str]) -> None:
    assert pieces_of_course(effects) == pieces


@pytest.mark.parametrize(
    ("target", "lumped", "counts"), [("motion", True, 0.025), ("pressure", True, 0.005), ("motion", False, 0.005)]
)
def test_a_lumped_body_may_leave_more_than_one_that_was_made_from_a_mesh(
    body: PccSimulator, target: str, lumped: bool, counts: float
) -> None:
    problem: Any = SimpleNamespace(target=target, simulator=body if lumped else None)
    judge = Judge(problem, floor=1e-5, travel=1.0, thresholds=configured().thresholds, seed=0)
    assert judge.form == pytest.approx(counts) and judge.material == pytest.approx(0.005)
