"""Hashes that say whether a stage would do the same work again."""

import ast
import functools
import hashlib
import importlib.util
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

PACKAGE = "softrl"
WITH = {".ele": ".node", ".node": ".ele", ".xdmf": ".h5", ".xmf": ".h5"}  # formats of meshes in two files, of which one is named


def of_values(values: Any) -> str:
    """Return a hash of plain nested values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()[:16]


def of_arrays(arrays: Mapping[str, Any]) -> str:
    """Return a hash over the names, types, shapes and bytes of arrays and plain values."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:16]


def of_folder(folder: Path) -> str:
    """Return a hash over the names and bytes of the files in a folder."""
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def of_named_files(node: Any) -> dict[str, str]:
    """Return path -> hash of every existing file that a string in the nested ``node`` names, and of the one read with it."""
    if isinstance(node, dict):
        return {path: mark for value in node.values() for path, mark in of_named_files(value).items()}
    if isinstance(node, (list, tuple)):
        return {path: mark for value in node for path, mark in of_named_files(value).items()}
    if isinstance(node, str) and ("/" in node or "." in node) and Path(node).is_file():
        named = Path(node)
        read = [named, named.with_suffix(WITH.get(named.suffix, named.suffix))]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest()[:16] for path in read if path.is_file()}
    return {}


def of_code(*modules: str) -> str:
    """Return a hash over the sources of ``modules`` and of all modules of this package that they import."""
    seen: set[str] = set()
    waiting = list(modules)
    while waiting:
        module = waiting.pop()
        if module not in seen and module.startswith(PACKAGE):
            seen.add(module)
            waiting += _imports(module)
    return of_values({module: _source(module) for module in seen})


@functools.cache
def _source(module: str) -> str:
    spec = importlib.util.find_spec(module)
    return Path(spec.origin).read_text() if spec and spec.origin else ""


@functools.cache
def _imports(module: str) -> tuple[str, ...]:
    found: list[str] = []
    for node in ast.walk(ast.parse(_source(module))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(PACKAGE):
            found += [
                node.module,
                *(f"{node.module}.{alias.name}" for alias in node.names if _is_module(f"{node.module}.{alias.name}")),
            ]
        elif isinstance(node, ast.Call):
            found += _by_name(node)
    return tuple(name for name in found if name.startswith(PACKAGE))


def _by_name(call: ast.Call) -> list[str]:
    """Return all modules of the package of which a call of the form ``import_module(f"package.{name}")`` loads one."""
    if not (isinstance(call.func, ast.Attribute) and call.func.attr == "import_module" and call.args):
        return []
    match call.args[0]:
        case ast.JoinedStr(values=[ast.Constant(value=str(start)), ast.FormattedValue()]) if start.startswith(f"{PACKAGE}."):
            spec = importlib.util.find_spec(start.removesuffix("."))
            folders = spec.submodule_search_locations or [] if spec else []
            return [start + path.stem for folder in folders for path in sorted(Path(folder).glob("*.py"))]
    return []


@functools.cache
def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False
