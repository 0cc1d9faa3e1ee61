"""A stage in a process of its own: what it raises is raised here, and it does not outlive what started it."""

import importlib
import typing
from pathlib import Path

import pytest

from softrl.aside import Aside
from softrl.core.errors import ConfigError, SolverError
from softrl.loop import TAKEN_BY_NONE
from softrl.pipeline import STAGES, outputs

UNKNOWN: dict[str, object] = {}


def test_no_stage_of_the_loop_takes_what_runs_aside() -> None:
    made = set(outputs(TAKEN_BY_NONE))
    for stage in STAGES:
        hints = typing.get_type_hints(importlib.import_module(f"softrl.{stage}.stage").run)
        taken = {kind.key() for hint in hints.values() for kind in (hint, *typing.get_args(hint)) if hasattr(kind, "key")}
        assert not made & taken, stage


def test_what_ends_the_stage_is_raised_where_it_is_waited_for(tmp_path: Path) -> None:
    aside = Aside("unheard_of", UNKNOWN, tmp_path, {})
    with pytest.raises(ConfigError, match="stage=unheard_of is unknown"):
        aside.outcome()
    with pytest.raises(ConfigError, match="unheard_of"):
        ended = Aside("unheard_of", UNKNOWN, tmp_path, {})
        ended._process.join()
        ended.check()


def test_a_stage_that_is_killed_or_stopped_says_so(tmp_path: Path) -> None:
    for end in (lambda aside: aside._process.kill(), Aside.stop):
        aside = Aside("unheard_of", UNKNOWN, tmp_path, {})
        end(aside)
        aside._process.join(20.0)
        assert not aside._process.is_alive()
        with pytest.raises(SolverError, match="killed; run the same command again"):
            aside.outcome()


def test_of_an_error_that_nobody_foresaw_the_log_says_where(tmp_path: Path) -> None:
    with pytest.raises(SolverError, match=rf"stage=mesh ended by KeyError: .*; {tmp_path}/softrl.log says where"):
        Aside("mesh", UNKNOWN, tmp_path, {}).outcome()
    told = (tmp_path / "softrl.log").read_text()
    assert "Traceback" in told and "run_stage" in told
