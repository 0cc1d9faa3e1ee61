"""From YAML nodes to typed objects: unknown keys, missing keys and wrong types die here, with the key's path."""

import dataclasses
import difflib
import importlib
import inspect
import math
import typing
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from softrl.core.errors import ConfigError

T = TypeVar("T")
Fill = Callable[[Any], Any]
TARGET = "_target_"
UNFILLED = object()


def build(node: Mapping[str, Any], cls: type[T], path: str, fill: Fill = lambda hint: UNFILLED) -> T:
    """Return ``cls`` built from the plain mapping ``node`` found at config key ``path``.

    Parameters
    ----------
    fill : returns the value of a constructor parameter by its type hint (a robot, an artifact), or ``UNFILLED``

    Raises
    ------
    ConfigError
        If a key is unknown or missing, a value has the wrong type or is out of range.
    """
    hints = constructor_hints(cls)
    given = {key: value for key, value in node.items() if key != TARGET}
    _refuse_unknown(given, hints, path)
    values: dict[str, Any] = {}
    for name, (hint, required) in hints.items():
        if name in given:
            values[name] = _value(given[name], hint, f"{path}.{name}", fill)
            continue
        filled = fill(hint)
        if filled is not UNFILLED:
            values[name] = filled
        elif required:
            raise ConfigError(f"{path}.{name} is missing; expected {_readable(hint)}")
    return cls(**values)


def build_target(node: Mapping[str, Any], path: str, fill: Fill = lambda hint: UNFILLED) -> Any:
    """Return the object that ``node['_target_']`` names, built from the rest of the node."""
    return build(node, target_class(node, path), path, fill)


def target_class(node: Mapping[str, Any], path: str) -> Any:
    """Return the class that ``_target_`` names; only classes of this package are allowed."""
    name = str(node.get(TARGET, ""))
    if not name.startswith("softrl."):
        raise ConfigError(f"{path}._target_={name or 'nothing'} is refused; it must name a class inside softrl.")
    module, _, attribute = name.rpartition(".")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ModuleNotFoundError, AttributeError) as error:
        raise ConfigError(f"{path}._target_={name} does not exist: {error}") from error


def target_modules(node: Any, path: str) -> list[str]:
    """Return the modules of the classes that ``node`` and what stands within it name."""
    if not isinstance(node, Mapping):
        return []
    inner = [module for key, value in node.items() for module in target_modules(value, f"{path}.{key}")]
    return inner + ([target_class(node, path).__module__] if TARGET in node else [])


def constructor_hints(cls: Any) -> dict[str, tuple[Any, bool]]:
    """Return name -> (type hint, whether it is required) of a constructor's parameters."""
    hints = typing.get_type_hints(cls if dataclasses.is_dataclass(cls) else cls.__init__)
    parameters = [p for p in inspect.signature(cls).parameters.values() if p.name != "self"]
    return {p.name: (hints.get(p.name, Any), p.default is inspect.Parameter.empty) for p in parameters}


def _refuse_unknown(given: Mapping[str, Any], known: Mapping[str, Any], path: str) -> None:
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
            raise ConfigError(f"{path}.{key}={given[key]} is an unknown key; {hint}")


def _value(value: Any, hint: Any, path: str, fill: Fill) -> Any:
    if isinstance(value, Mapping) and TARGET in value:
        return build_target(value, path, fill)
    if isinstance(value, Mapping) and value and all(isinstance(v, Mapping) and TARGET in v for v in value.values()):
        return {key: build_target(inner, f"{path}.{key}", fill) for key, inner in value.items()}
    if isinstance(value, str) and value == "???":
        raise ConfigError(f"{path} is not set; give {path}=<{_readable(hint).removesuffix(' | None')}>")
    if dataclasses.is_dataclass(hint) and isinstance(hint, type) and not isinstance(value, hint):
        if isinstance(value, Mapping):
            return build(value, hint, path, fill)
        raise ConfigError(f"{path}={value!r} has the wrong type; expected the keys of {_readable(hint)}")
    try:
        found = TypeAdapter(hint, config={"arbitrary_types_allowed": True}).validate_python(value)
    except ValidationError as error:
        raise ConfigError(
            f"{path}={value!r} has the wrong type; expected {_readable(hint)}: {error.errors()[0]['msg']}"
        ) from error
    if not _is_finite(found):  # nan passes whatever range is checked
        raise ConfigError(f"{path}={value!r}; expected finite numbers")
    return found


def _is_finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def _readable(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) else str(hint).replace("typing.", "")
