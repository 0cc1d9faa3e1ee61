"""An output folder of its own for each command, whatever else begins in the same second."""

import itertools
import os
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

TWIN_VARIABLE = "SOFTRL_TWIN"  # ends the folder's name, see conf/config.yaml; read by a sweep's points in their processes, too


class OwnFolder(Callback):
    """Makes the folder of a run, or of a sweep, before Hydra does; where there is one already its name ends in -2, -3 .."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of a run."""
        claim(config.hydra.run)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Make the folder of a sweep, in which its points have theirs."""
        claim(config.hydra.sweep)


def claim(node: DictConfig) -> None:
    """Make the folder ``node.dir`` under a name that no other command has; one that the user named may be there already."""
    os.environ[TWIN_VARIABLE] = ""
    for number in itertools.count(2):
        folder = Path(node.dir)
        try:
            folder.mkdir(parents=True)
            return
        except FileExistsError:
            os.environ[TWIN_VARIABLE] = f"-{number}"
        if Path(node.dir) == folder:
            return
