"""The command line, as a user calls it."""

import subprocess
import sys
from pathlib import Path


def softrl(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "softrl", *words], cwd=folder, capture_output=True, text=True, check=False, timeout=1800
    )
