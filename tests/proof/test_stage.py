"""The seal holds, a stopped proof goes on, and the whole stage writes what tools read."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.tracking import NullTracker
from softrl.proof import blackbox, stage
from softrl.proof.generator.program import Range, outside, sessions
from softrl.proof.ledger import digest, open_key, require_untouched, seal
from softrl.proof.shelf import kept
from softrl.proof.trial import SHORTEST_S
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.proof.conftest import configured


class Texts(NullTracker):
    """Keeps every text in the order in which it came."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[tuple[str, str]] = []

    def text(self, name: str, content: str) -> None:
        self.texts.append((name, content))


def test_a_robot_that_reports_an_angle_is_refused_at_once(tmp_path: Path, tripod: Robot) -> None:
    """Hidden robots are recorded by the tip's position: what is wrong with the set-up would count as false alarms."""
    config, finger = configured(folder=str(tmp_path)), replace(tripod, output="bend_angle")
    with pytest.raises(ConfigError, match=r"robot=tripod reports bend_angle, .*; choose a robot whose output is tip_position"):
        stage.run(config, finger, tracker=NullTracker())
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"session_s": 3.0}, r"session_s=3; expected .* 7 s or more, of which the pauses take 4"),
        ({"links": 0}, "links=0, .*; expected 1 or more"),
        ({"position_noise_m": 0.0}, "position_noise_m=0 must be positive"),
        ({"pressure_noise_pa": -1.0}, "pressure_noise_pa=-1 must not be negative"),
        ({"share": 1.5}, "share=1.5 must lie between 0 and 1"),
        ({"dropped_share": 1.0}, "dropped_share=1; expected 0 or more, and below 1"),
    ],
)
def test_what_no_session_can_be_drawn_from_is_refused_with_its_key(changed: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError, match=rf"stage.generator\..*{told}") as error:
        configured(generator=changed)
    assert "\n" not in str(error.value)


def test_the_shortest_sessions_can_be_drawn() -> None:
    rng, limits = np.random.default_rng(0), Range(-20e3, 35e3, 1e6, 3)
    for session in [*sessions(limits, 8, SHORTEST_S, 0.75, rng), outside(limits, SHORTEST_S, 0.4, rng)]:
        assert np.isfinite(session.command).all() and (np.ptp(session.command, axis=0).max() > 0.0).all()


def test_a_key_that_was_changed_does_not_open(tmp_path: Path) -> None:
    path, key = tmp_path / "key.json", [{"case": 0, "hidden": [{"name": "spool"}]}]
    told = seal(path, key)
    assert told == digest(key) and open_key(path, told) == key
    path.write_text(path.read_text().replace("spool", "choke"))
    with pytest.raises(ArtifactError, match="proof is void"):
        open_key(path, told)
    with pytest.raises(ArtifactError, match="another answer key"):
        seal(path, key)


def test_recordings_that_were_changed_are_noticed(tmp_path: Path) -> None:
    key = [{"folder": "a", "files_sha256": "1"}]
    require_untouched(tmp_path, key, lambda folder, name: "1")
    with pytest.raises(ArtifactError, match="not those of the key"):
        require_untouched(tmp_path, key, lambda folder, name: "2")


def test_work_is_done_once_and_half_of_it_never_counts(tmp_path: Path) -> None:
    place, calls = tmp_path / "a" / "case.json", []

    def work(value: int, fails: bool) -> int:
        calls.append(value)
        if fails:
            raise KeyboardInterrupt
        return value

    with pytest.raises(KeyboardInterrupt):
        kept(work, (1, True), place)
    assert not place.exists()
    assert kept(work, (2, False), place) == 2 == kept(work, (3, False), place)
    assert calls == [1, 2]


def test_the_black_box_learns_a_filter_and_its_square() -> None:
    rng = np.random.default_rng(0)
    runs = []
    for number in range(4):
        time = 0.02 * np.arange(1, 600)
        held = np.repeat(rng.uniform(0.0, 30e3, (12, 1)), 50, axis=0)[:599]
        state, slow = 0.0, np.empty(599)
        for k in range(599):
            state += -np.expm1(-0.02 / 0.2) * (held[k, 0] - state)
            slow[k] = state / 30e3
        tip = 0.03 * np.stack([slow, slow**2, 1.0 - 0.2 * slow], axis=1)
        runs.append(Recording(f"r{number}", "s", time, held, position=tip + 1e-5 * rng.standard_normal(tip.shape)))
    apart = blackbox.fit(runs[:3]).predict(runs[3]) - runs[3].position
    assert np.sqrt(np.mean(apart**2)) < 0.1 * np.std(runs[3].position[:, 0])


def test_the_stage_seals_first_opens_last_and_goes_on(
    tmp_path: Path, tripod: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an engine that always answers the same, and that is killed at its second case."""
    asked: list[str] = []

    def engine(recordings: Path, *_: Any) -> dict[str, Any]:
        asked.append(recordings.name)
        if len(asked) == 2:
            raise KeyboardInterrupt
        nominal = {"bending_stiffness_scale": 1.0, "axial_stiffness_scale": 1.0, "damping_s": 0.05, "mass_scale": 1.0}
        return {"verdict": "nothing missing", "effects": [], "corrections": [], "rivals": [], "located": [],
                "simulator_parameters": nominal, "retuned": nominal, "retuned_late_s": 0.0,
                "training_runs": [], "heldout_runs": [], "seconds": 1.0}  # fmt: skip

    monkeypatch.setattr(stage, "answer", engine)
    config = configured(cases=2, shuffled_cases=0, folder=str(tmp_path))
    with pytest.raises(KeyboardInterrupt):
        stage.run(config, tripod, tracker=NullTracker())
    tracker = Texts()
    proof = stage.run(config, tripod, tracker=tracker)
    assert len(asked) == 3 and len(set(asked)) == 2  # the finished case was not asked again
    ledgers = [json.loads(text) for name, text in tracker.texts if name == "ledger.json"]
    assert len(ledgers) == 3 and "key" not in ledgers[0] and "key" not in ledgers[1]
    assert {entry["key_sha256"] for entry in ledgers} == {digest(ledgers[-1]["key"])} == {proof.key_sha256}
    assert ledgers[1]["answers_sha256"] == digest(ledgers[-1]["answers"])
    assert {row["stratum"] for row in proof.rows} == {"null", "outside"}
    for name in ("cases", "false_alarm_pct", "unknown_flagged_pct", "seconds_per_case", "shuffled_cases"):
        assert tracker.metrics[name] == proof.metrics[name]
    assert tracker.metrics["false_alarm_pct"] == 0.0 and tracker.metrics["unknown_flagged_pct"] == 0.0
    assert 0.1 < proof.rows[0]["outside_oracle_mm"] < 0.3


def test_proof_keys_are_short_for_the_stage_s() -> None:
    from softrl.__main__ import _spell_out

    assert _spell_out("proof.cases=120") == ["stage.cases=120"]
    assert _spell_out("stage=proof") == ["stage=proof"]
