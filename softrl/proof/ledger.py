"""The seal: a key is hashed before anything is diagnosed, and opened only when every answer is frozen."""

import hashlib
import json
from pathlib import Path
from typing import Any

from softrl.core.errors import ArtifactError
from softrl.core.store import write_text


def text_of(value: Any) -> str:
    """Return the one text in which a value is hashed and stored."""
    return json.dumps(value, sort_keys=True, indent=1)


def digest(value: Any) -> str:
    """Return the SHA-256 of a value's text."""
    return hashlib.sha256(text_of(value).encode()).hexdigest()


def seal(path: Path, key: list[dict[str, Any]]) -> str:
    """Write the key and return its SHA-256; a key that is there already must be the same."""
    if path.is_file() and path.read_text() != text_of(key):
        raise ArtifactError(f"{path} holds another answer key than these cases have; remove the folder and start anew")
    write_text(path, text_of(key))
    return digest(key)


def open_key(path: Path, sealed_sha256: str) -> list[dict[str, Any]]:
    """Return the key if it is the one that was sealed.

    Raises
    ------
    ArtifactError
        If its SHA-256 is another than the one told before.
    """
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != sealed_sha256:
        raise ArtifactError(
            f"{path} has SHA-256 {found[:16]}.., but {sealed_sha256[:16]}.. was sealed: the key was changed; the proof is void"
        )
    key: list[dict[str, Any]] = json.loads(path.read_text())
    return key


def require_untouched(folder: Path, key: list[dict[str, Any]], measure: Any) -> None:
    """Raise ``ArtifactError`` unless the files of every case in ``folder`` are those that the key was made with."""
    for entry in key:
        if measure(folder, entry["folder"]) != entry["files_sha256"]:
            raise ArtifactError(
                f"recordings or truth of case {entry['folder']} in {folder} are not those of the key; the proof is void"
            )
