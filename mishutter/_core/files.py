"""Files that are read up to a size, and that appear whole or not at all."""

import json
import math
import os
import stat
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

_MOST_BYTES = 1 << 26
"""Far beyond any scene or design; what has no end, as `/dev/zero`, is found out by it."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def contents(path: str | Path) -> bytes:
    """The contents of a scene or design file.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is larger than 64 MiB.
    """
    with Path(path).open("rb") as file:
        found = file.read(_MOST_BYTES + 1)
    if len(found) > _MOST_BYTES:
        raise ValueError(f"{path} must be a file of at most 64 MiB; got more.")
    return found


def write_text(path: str | Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file beside its place, then move it there in one step.

    Raises:
        OSError: if it cannot be written.
    """
    target = Path(path)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        move_into_place(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def move_into_place(temporary: str | Path, target: str | Path) -> None:
    """Give a finished temporary file its name, and the permissions that any new file has.

    Raises:
        OSError: if it cannot be moved.
    """
    umask = os.umask(0)
    os.umask(umask)
    os.chmod(temporary, 0o666 & ~umask)
    os.replace(temporary, target)


def writable_folder(path: str | Path) -> Path:
    """A folder that is there and takes files, made if need be: asked before long work.

    Raises:
        OSError: if it cannot be made or takes no files.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise OSError(
            f"`--out` must be a folder that takes files; got {str(path)!r}: {reason}."
        ) from None
    return folder


def is_own_folder(path: Path) -> bool:
    """Whether a folder takes files of this user alone: it is there, or is made, and is theirs.

    Where others may write to it, they no longer may: what lies in it is run.
    """
    if not path.is_absolute():  # `~` of a user without a home
        return False
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
        if hasattr(os, "getuid") and found.st_uid != os.getuid():
            return False
        if found.st_mode & _OTHERS_WRITE:
            path.chmod(stat.S_IMODE(found.st_mode) & ~_OTHERS_WRITE)
    except OSError:
        return False
    return os.access(path, os.W_OK)


def short_names(paths: Iterable[Path], taken: Iterable[str] = ()) -> dict[str, Path]:
    """Files by as much of the end of their paths as tells them apart, without suffix.

    Args:
        paths: The files.
        taken: Names that none of them may have.
    """
    ends = {path: _ends(path.absolute()) for path in paths}
    counts = Counter(taken) + Counter(end for each in ends.values() for end in each)
    return {next((e for e in each if counts[e] == 1), str(p)): p for p, each in ends.items()}


def _ends(path: Path) -> list[str]:
    parts = (*path.parts[:-1], path.stem)
    return [str(Path(*parts[first:])) for first in reversed(range(len(parts)))]


def strict_json(document: Any) -> str:
    """JSON without the tokens that JSON does not have: `"Infinity"`, and null for NaN."""
    return json.dumps(_plain(document), allow_nan=False, indent=1)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        if math.isnan(value):
            return None
        return value if math.isfinite(value) else f"{'-' if value < 0 else ''}Infinity"
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value if isinstance(value, str | int | bool | None) else str(value)
