"""The catalogue of effects: every module of this package that holds one."""

import importlib
from functools import cache
from pathlib import Path

from softrl.core.errors import ConfigError
from softrl.effects.effect import SITES, Effect

NOT_EFFECTS = (
    "__init__", "effect", "bending", "call", "chain", "library", "history", "driving", "free_motion", "gate", "port",
    "quaternion", "relaxation", "replay", "way",
)  # fmt: skip


@cache
def names() -> list[str]:
    """Return the names of all effects in the library, sorted; nothing is imported."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in NOT_EFFECTS)


@cache
def effect_class(name: str) -> type[Effect]:
    """Return the class of the effect called ``name``.

    Raises
    ------
    ConfigError
        If there is none of that name.
    """
    if name not in names():
        raise ConfigError(f"effect '{name}' is unknown; expected one of {', '.join(names())}")
    module = importlib.import_module(f"softrl.effects.{name}")
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Effect) and value.__module__ == module.__name__
    ]
    if len(found) != 1 or found[0].site not in SITES:
        raise ConfigError(f"softrl/effects/{name}.py must hold one effect at a site out of {', '.join(SITES)}")
    return found[0]
