import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("MPLBACKEND", "Agg")

# the whole loop compiles the reduced body's kernels, for minutes; what needs nothing but them waits until it has
FIRST, LAST = Path("pipeline/test_loop.py"), ("bench", "calibration", "contracts", "dynamics", "pod")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the whole loop first, and last the folders whose tests would compile beside it what it compiles."""

    def place(item: pytest.Item) -> int:
        within = item.path.relative_to(ROOT / "tests")
        return 0 if within == FIRST else 2 if within.parts[0] in LAST else 1

    items.sort(key=place)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The validation data folder; a test that needs it is skipped where it is absent."""
    folder = Path(os.environ.get("SOFTRL_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no validation data: set SOFTRL_REAL_DATA")
    return folder
