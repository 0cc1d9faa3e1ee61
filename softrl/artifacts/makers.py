"""Which stage makes which artifact, and what ``inputs`` may say of one."""

import importlib
import pkgutil
from collections.abc import Mapping
from typing import Any

from softrl import artifacts
from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ConfigError


def makers() -> dict[str, str]:
    """Return artifact name -> the stage that makes it."""
    for module in pkgutil.iter_modules(artifacts.__path__):
        importlib.import_module(f"{artifacts.__name__}.{module.name}")
    ours = [kind for kind in Artifact.__subclasses__() if kind.__module__.startswith("softrl.")]
    return {kind.key(): kind.stage for kind in ours}


def inputs_in_words() -> str:
    """Return the artifact names, each with the stage that makes it."""
    return ", ".join(f"{name} (of stage={stage})" for name, stage in makers().items())


def check_inputs(inputs: Mapping[str, Any]) -> None:
    """Refuse names that no stage makes, and what says nothing about where an artifact is."""
    for name, source in inputs.items():
        if name not in makers():
            raise ConfigError(f"inputs.{name}={source} is an unknown key; expected one of {inputs_in_words()}")
        if source != "latest" and not str(source).startswith(("run:", "path:")):
            raise ConfigError(f"inputs.{name}={source} is refused; expected latest, run:<id> or path:<folder>")
