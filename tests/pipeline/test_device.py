"""Stages at a robot: none is done by a run of before, what it leaves belongs to its driver and simulator, no chance is shared."""

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.diagnosis import Diagnosis
from softrl.assembly import NOMINAL, Assembly
from softrl.calibration import stage as calibration_stage
from softrl.core.config import build
from softrl.core.errors import ArtifactError, DriverError
from softrl.core.origin import in_words, is_real
from softrl.core.store import Location, Store
from softrl.core.tracking import NullTracker
from softrl.effects.chain import EffectChain
from softrl.pipeline import RESULT, _prepare, outputs, run_stage
from softrl.recordings.recording import RecordingSet
from softrl.sim2real import stage as sim2real_stage
from tests.pipeline.test_root import CONF, composed

UDP = ("driver=udp", "driver.host=127.0.0.1", "driver.port=9")
RIG, ROM, PCC = "StubDriver (RomSimulator, Lag, Viscoelasticity, Hysteresis)", "RomSimulator", "PccSimulator"


class Shelf:
    """A store of runs that are nothing but tags."""

    def __init__(self) -> None:
        self.runs: list[Any] = []

    def keep(self, **tags: str) -> str:
        """Keep a finished run with ``tags`` and return its id."""
        told = {f"softrl.{key}": value for key, value in tags.items()}
        run_id = f"{len(self.runs) + 1:032x}"[::-1]
        self.runs.insert(0, SimpleNamespace(info=SimpleNamespace(run_id=run_id), data=SimpleNamespace(tags=told)))
        return run_id

    def every(self, tags: dict[str, str]) -> list[Any]:
        wanted = {f"softrl.{key}": value for key, value in tags.items()}.items()
        return [run for run in self.runs if wanted <= run.data.tags.items()]

    def find(self, tags: dict[str, str]) -> Any:
        return next(iter(self.every(tags)), None)

    def get(self, run_id: str) -> Any:
        return next(run for run in self.runs if run.info.run_id == run_id)

    def folder(self, run: Any, name: str) -> Path:
        return Path(name)


@pytest.fixture
def shelf() -> Shelf:
    return Shelf()


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("project")


def keep(folder: Path, **tags: str) -> str:
    """Keep a finished run with ``tags``, and the artifacts of its stage by name, in a store and return its id."""
    with Store(Location(None, str(folder))).start("run", tags, None) as run:
        run.text(RESULT, json.dumps({"seconds": 1.0, "metrics": {}, "artifacts": {}}))
        for name in outputs(tags["stage"]):
            run.text(f"{name}/meta.json", "{}")
    return run.id


@pytest.mark.parametrize("driver", sorted(path.stem for path in (CONF / "driver").glob("[!_]*.yaml")))
def test_a_driver_is_real_where_no_body_is_simulated_behind_it(driver: str) -> None:
    chosen = {"serial": ("driver.port=/dev/ttyUSB0",), "udp": UDP[1:]}.get(driver, ())
    assert is_real(composed("stage=calibration", f"driver={driver}", *chosen)["driver"]) == (driver in ("serial", "udp"))


@pytest.mark.parametrize(("words", "alone"), [(UDP, False), (("driver=stub_pcc",), True)])
def test_what_a_real_robot_did_is_gone_on_from_in_a_loop_alone(
    words: tuple[str, ...], alone: bool, project: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cfg = composed("stage=calibration", "profile=tiny", "simulator=pcc", *words, f"tracking.folder={project}")
    mark = _prepare("calibration", cfg, None).mark
    run_id = keep(project, stage="calibration", fingerprint=mark)
    assert (_prepare("calibration", cfg, None).before is not None) == alone
    assert run_stage("calibration", cfg, tmp_path / "again", {}).run_id == run_id
    assert ("the robot is not moved" in caplog.text) == (not alone)


def test_a_bench_is_reused_by_a_paper_alone(project: Path) -> None:
    cfg = composed("stage=bench", f"tracking.folder={project}") | {"bench": {}}
    keep(project, stage="bench", fingerprint=_prepare("bench", cfg, None).mark)
    assert _prepare("bench", cfg, None).before is None and _prepare("bench", cfg, {}).before is not None


def assembly(shelf: Any, *words: str, takes: tuple[str, ...] = ("driver", "simulator")) -> Assembly:
    """Return the assembly of stage sim2real, or of one that takes other objects."""
    made = Assembly(shelf, composed("stage=sim2real", *words), {})
    made._takes = list(takes)
    return made


def tags_of(made: Assembly, kind: Any, **others: str) -> dict[str, str]:
    return made._tags_of(kind) | others


def test_the_latest_map_is_of_the_same_driver_and_simulator(shelf: Shelf, caplog: pytest.LogCaptureFixture) -> None:
    at_rig, at_robot = assembly(shelf), assembly(shelf, *UDP)
    tags = tags_of(at_rig, Calibration, simulator=ROM)
    assert tags["effects"] == NOMINAL
    ours = shelf.keep(**tags, driver="UdpDriver")
    other = shelf.keep(**tags | {"simulator": PCC}, driver="UdpDriver")
    rigs = shelf.keep(**tags, driver=RIG)
    assert at_robot._locate(Calibration, "calibration")[1] == ours and at_rig._locate(Calibration, "calibration")[1] == rigs
    assert assembly(shelf, *UDP, "simulator=pcc")._locate(Calibration, "calibration")[1] == other
    assert assembly(shelf, *UDP, f"inputs.calibration=run:{rigs}")._locate(Calibration, "calibration")[1] == rigs, "insisted"
    assert not caplog.records
    old = shelf.keep(**{key: value for key, value in tags.items() if key != "simulator"})
    assert at_robot._locate(Calibration, "calibration")[1] == old and "does not tell its driver and simulator" in caplog.text


def test_the_map_of_a_rig_is_refused_at_a_robot(shelf: Shelf) -> None:
    at_robot = assembly(shelf, *UDP)
    rigs = shelf.keep(**tags_of(at_robot, Calibration, simulator=ROM, driver=RIG))
    told = re.escape(
        f"run {rigs[:8]} was made with driver {RIG}, and none with the configured driver UdpDriver, simulator {ROM}; run "
        f"stage=calibration so first, or insist with inputs.calibration=run:{rigs[:8]}"
    )
    with pytest.raises(ArtifactError, match=told):
        at_robot._locate(Calibration, "calibration")


def test_a_map_of_another_simulator_is_left_out_where_none_is_needed(shelf: Shelf, caplog: pytest.LogCaptureFixture) -> None:
    """As in a diagnosis, which takes the simulator and no driver."""
    made = assembly(shelf, takes=("simulator",))
    shelf.keep(**tags_of(made, Calibration, simulator=PCC, driver="UdpDriver"))
    assert made._argument("calibration", Calibration | None) is None
    assert "there is no Calibration for what is configured" in caplog.text
    assert made._argument("diagnosis", Diagnosis | None) is None


def test_recordings_of_a_robot_are_told_from_those_of_a_rig(shelf: Shelf, caplog: pytest.LogCaptureFixture) -> None:
    either, robots = (assembly(shelf, *words, takes=("simulator",)) for words in ((), UDP))
    tags = tags_of(either, RecordingSet, simulator=PCC)
    rigs = shelf.keep(**tags, driver=RIG)
    assert either._locate(RecordingSet, "recording_set")[1] == rigs and not caplog.records, "whatever the simulator"
    with pytest.raises(ArtifactError, match="none with the configured driver UdpDriver; run stage=sim2real so first"):
        robots._recordings(optional=False)
    ours = shelf.keep(**tags, driver="UdpDriver")
    assert either._locate(RecordingSet, "recording_set")[1] == ours
    assert f"run {ours[:8]}, made with driver UdpDriver; configured is driver {RIG}" in caplog.text
    shelf.keep(**tags, driver=RIG)
    assert robots._locate(RecordingSet, "recording_set")[1] == ours


def test_runs_tell_what_they_were_made_with() -> None:
    made = Assembly(None, composed("stage=calibration", "effect=none"), {})  # type: ignore[arg-type]
    made.used |= {"driver": made.cfg["driver"], "simulator": made.cfg["simulator"]}
    assert made.own_tags() == {"driver": RIG, "simulator": ROM} and in_words(made.cfg["driver"]) == RIG
    made.used["recordings"] = "a folder: nothing was driven"
    assert made.own_tags() == {"simulator": ROM} and not made.at_device


def test_no_chance_is_shared_by_stages_that_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """One seed gives each its own programs, and a rig's noise that is neither the other stage's nor any program's."""
    drawn: dict[str, float] = {}

    def record_holds(*given: Any) -> None:
        drawn["holds"] = next(each for each in given if isinstance(each, np.random.Generator)).random()
        raise DriverError("far enough")

    def record_sessions(driver: Any, robot: Any, settings: Any, rng: np.random.Generator) -> list[Any]:
        drawn["sessions"] = rng.random()
        return []

    monkeypatch.setattr(calibration_stage, "record_holds", record_holds)
    monkeypatch.setattr(sim2real_stage, "record_sessions", record_sessions)
    for stage in (calibration_stage, sim2real_stage):
        words = (f"stage={stage.__name__.split('.')[1]}", "simulator=pcc", "driver=stub_pcc", "stage.seed=3", "seed=3")
        made = Assembly(None, composed(*words), {})  # type: ignore[arg-type]
        made.modules.append(stage.__name__)
        driver = made._object("driver")
        noise = np.random.default_rng((driver._seed, 0, driver._stream))
        drawn[f"noise of {stage.__name__}"] = noise.random()
        config = build(made.cfg["stage"], stage.Config, "stage")
        if stage is sim2real_stage:
            stage._identify(config, driver, made.robot, [], NullTracker())
        else:
            given = (config, made.robot, made._object("simulator"), EffectChain(made.robot), driver, None)
            with pytest.raises(DriverError, match="far enough"):
                stage.run(*given, tracker=NullTracker())
    assert len(drawn) == 4 and len(set(drawn.values())) == 4
