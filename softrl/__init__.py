"""softrl: from simulation to hardware in soft robotics."""

from pathlib import Path

from softrl.core.kernels import keep_by_code

keep_by_code(Path(__file__).parent)
