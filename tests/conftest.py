import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The validation data folder; a test that needs it is skipped where it is absent."""
    folder = Path(os.environ.get("SOFTRL_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("no validation data: set SOFTRL_REAL_DATA")
    return folder
