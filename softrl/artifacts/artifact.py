"""What stages hand to each other: frozen records of arrays and plain values, saved without pickle."""

import dataclasses
import json
import re
import shutil
import typing
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self
from zipfile import BadZipFile

import numpy as np

from softrl.core.errors import ArtifactError

META, ARRAYS = "meta.json", "arrays.npz"
# what readers of JSON and of compressed archives raise where a file is not what was written (RuntimeError: a method of
# compression that there is not, a password)
DAMAGE = (KeyError, TypeError, ValueError, OSError, EOFError, RuntimeError, BadZipFile, zlib.error)


@dataclass(frozen=True)
class Artifact:
    """A noun of the pipeline: fields are arrays, dicts of arrays, or values that JSON can hold.

    A subclass sets ``schema`` (raised whenever its fields change meaning) and ``stage`` (the stage that makes
    it, named in error messages), and may override ``validate``.
    """

    schema: ClassVar[int] = 1
    stage: ClassVar[str] = ""

    @classmethod
    def kind(cls) -> str:
        """Return the name under which this artifact is stored."""
        return cls.__name__

    @classmethod
    def key(cls) -> str:
        """Return the name in ``inputs.<name>`` and of the folder in a run, e.g. ``reduced_model``."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def validate(self) -> None:
        """Raise ``ArtifactError`` unless shapes and values are consistent; the base checks finiteness."""
        for name, array in _arrays_of(self).items():
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                bad = int((~np.isfinite(array)).sum())
                raise ArtifactError(f"{self.kind()}.{name} holds {bad} values that are not finite")

    def save(self, folder: Path) -> None:
        """Write the artifact to ``folder`` through a temporary sibling, so that no half of it is ever seen."""
        self.validate()
        part = folder.with_name(folder.name + ".part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        self.write(part)
        shutil.rmtree(folder, ignore_errors=True)
        part.rename(folder)

    def write(self, folder: Path) -> None:
        """Write the files of this artifact; a subclass with a format of its own overrides this and ``read``."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        plain = {k: v for k, v in values.items() if not _is_array(v) and not _is_array_dict(v)}
        meta = {"kind": self.kind(), "schema": self.schema, "values": plain,
                "array_dicts": [k for k, v in values.items() if _is_array_dict(v)]}
        (folder / META).write_text(json.dumps(meta, indent=1, default=_jsonable))
        np.savez_compressed(folder / ARRAYS, allow_pickle=False, **_arrays_of(self))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read an artifact of this class back.

        Raises
        ------
        ArtifactError
            If the folder holds nothing, another kind, another schema number, or less than the whole.
        """
        if not (folder / META).is_file():
            raise ArtifactError(f"{folder} holds no {cls.kind()}: {META} is missing; run stage={cls.stage}")
        with _told_as_damage(folder, cls):
            meta = json.loads((folder / META).read_text())
            kind, schema = meta["kind"], meta["schema"]
        if kind != cls.kind():
            raise ArtifactError(f"{folder} holds a {kind}, but a {cls.kind()} is needed")
        if schema != cls.schema:
            raise ArtifactError(
                f"{folder} holds {cls.kind()} of schema {schema}, this version reads schema {cls.schema}; "
                f"rerun stage={cls.stage}"
            )
        with _told_as_damage(folder, cls):
            made = cls.read(folder, meta)
            made.validate()
        return made

    @classmethod
    def read(cls, folder: Path, meta: dict[str, Any]) -> Self:
        """Build the artifact from the files that ``write`` made."""
        values: dict[str, Any] = {name: {} for name in meta["array_dicts"]}
        with np.load(folder / ARRAYS, allow_pickle=False) as data:
            for key in data.files:
                name, _, inner = key.partition("/")
                if inner:
                    values[name][inner] = data[key]
                else:
                    values[name] = data[key]
        hints = typing.get_type_hints(cls)
        for name, value in meta["values"].items():
            wants_tuple = typing.get_origin(hints.get(name)) is tuple
            values[name] = tuple(value) if wants_tuple and isinstance(value, list) else value
        return cls(**values)


@contextmanager
def _told_as_damage(folder: Path, kind: type[Artifact]) -> Iterator[None]:
    """Turn what files that are not whole raise into the message of one line."""
    try:
        yield
    except DAMAGE as error:
        raise ArtifactError(
            f"{folder} holds a damaged {kind.kind()} ({type(error).__name__}: {error}); rerun stage={kind.stage}"
        ) from error


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)


def _is_array_dict(value: Any) -> bool:
    return isinstance(value, dict) and bool(value) and all(_is_array(v) for v in value.values())


def _arrays_of(artifact: Artifact) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for field in dataclasses.fields(artifact):
        value = getattr(artifact, field.name)
        if _is_array(value):
            found[field.name] = value
        elif _is_array_dict(value):
            found |= {f"{field.name}/{key}": array for key, array in value.items()}
    return found


def _jsonable(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"{type(value).__name__} cannot be stored in {META}")
