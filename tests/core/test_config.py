"""Typed configurations: what is wrong is named with its key; only classes of this package are built."""

from dataclasses import dataclass

import pytest

from softrl.core.config import build, build_target
from softrl.core.errors import ConfigError


@dataclass(frozen=True)
class Inner:
    share: float


@dataclass(frozen=True)
class Outer:
    count: int
    band_hz: tuple[float, float]
    inner: Inner
    note: str | None


GOOD = {"count": 3, "band_hz": [0.1, 2], "inner": {"share": 0.5}, "note": None}


def test_lists_become_tuples_and_mappings_dataclasses() -> None:
    assert build(GOOD, Outer, "stage") == Outer(3, (0.1, 2.0), Inner(0.5), None)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"count": "three"}, "stage.count='three' has the wrong type; expected int"),
        ({"count": 2.5}, "stage.count=2.5"),
        ({"band_hz": [1.0]}, "stage.band_hz"),
        ({"inner": {"shre": 1.0}}, "stage.inner.shre=1.0 is an unknown key; did you mean share?"),
        ({"inner": {}}, "stage.inner.share is missing"),
        ({"inner": 3}, "stage.inner=3 has the wrong type; expected the keys of Inner"),
        ({"note": "???"}, "stage.note is not set"),
        ({"inner": {"share": float("nan")}}, "stage.inner.share=nan; expected finite numbers"),
        ({"band_hz": [0.1, float("inf")]}, "stage.band_hz"),
    ],
)
def test_a_wrong_value_is_named_with_its_key(change: dict, says: str) -> None:
    with pytest.raises(ConfigError, match=says.replace("?", r"\?")):
        build(GOOD | change, Outer, "stage")


@pytest.mark.parametrize("target", ["os.system", "", "softrlx.evil", "builtins.eval"])
def test_a_target_outside_the_package_is_refused(target: str) -> None:
    with pytest.raises(ConfigError, match="refused"):
        build_target({"_target_": target}, "effect.x")


def test_a_target_that_does_not_exist_says_so() -> None:
    with pytest.raises(ConfigError, match="does not exist"):
        build_target({"_target_": "softrl.effects.lag.Lagg"}, "effect.lag")
