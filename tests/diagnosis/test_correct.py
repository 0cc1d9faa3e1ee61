"""How much of the gap between simulator and recordings a correction closes."""

import pytest

from softrl.diagnosis.judging.correct import share_closed


@pytest.mark.parametrize(
    ("nominal", "corrected", "share"),
    [(10.0, 1.0, 1.0), (10.0, 4.0, 2.0 / 3.0), (10.0, 10.0, 0.0), (10.0, 19.0, -1.0), (1.2, 1.0, None)],
)
def test_it_is_the_way_of_the_rms_error_from_nominal_to_the_noise(nominal: float, corrected: float, share: float | None) -> None:
    found = share_closed({"nominal": nominal, "corrected": corrected, "noise_floor": 1.0})
    assert found == (None if share is None else pytest.approx(share))
