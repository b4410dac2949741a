"""Reading of files up to a size, and atomic writes."""

import json
import math
import os
import stat
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

RECOMMENDED, ONE_EXPOSURE = "recommended.json", "one_exposure.json"
"""Designs in the folder of an answer: of what is recommended, and of the best single exposure."""
FORMER = ("build.json", "design.json")
"""Names in version 0.2: of what is recommended, and without it of that or of one exposure."""
_MOST_BYTES = 1 << 26
"""More than any scene or design; the bound stops the reading of an endless `/dev/zero`."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def contents(path: str | Path) -> bytes:
    """The contents of a scene or design file, of 64 MiB at most."""
    with Path(path).open("rb") as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise ValueError(f"{path} must be a file of at most 64 MiB; got more.")
    return content


def write_text(path: str | Path, text: str) -> None:
    """Writes a text file whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | Path, content: bytes) -> None:
    """Writes a temporary file in the same folder, then renames it to `path` in one step.

    An error names `path`, where a full disk would name no file.
    """
    target = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)  # the permissions of any new file
            os.replace(temporary, target)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(target)) from error


def writable_folder(path: str | Path) -> Path:
    """A folder that exists and takes files, created if need be; a check before long work."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise OSError(f"`--out` must be a writable folder; got {str(path)!r}: {reason}.") from None
    return folder


def is_own_folder(path: Path) -> bool:
    """Whether a folder exists, created if need be, and this user alone may write to it.

    The function takes write permission from all others, because the folder holds compiled code.
    """
    if not path.is_absolute():  # `~` of a user without a home
        return False
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = path.stat()
        if hasattr(os, "getuid") and status.st_uid != os.getuid():
            return False
        if status.st_mode & _OTHERS_WRITE:
            path.chmod(stat.S_IMODE(status.st_mode) & ~_OTHERS_WRITE)
    except OSError:
        return False
    return os.access(path, os.W_OK)


def short_names(paths: Iterable[Path], taken: Iterable[str] = ()) -> dict[str, Path]:
    """Files by the shortest end of their paths, without suffix, that is unique among them."""
    ends = {}
    for path in paths:
        parts = (*path.absolute().parts[:-1], path.absolute().stem)
        ends[path] = [str(Path(*parts[first:])) for first in reversed(range(len(parts)))]
    counts = Counter(taken) + Counter(end for each in ends.values() for end in each)
    return {next((e for e in each if counts[e] == 1), str(p)): p for p, each in ends.items()}


def strict_json(document: object) -> str:
    """Standard JSON: infinities become the text `"Infinity"`, and NaN becomes null."""
    return json.dumps(_plain(document), allow_nan=False, indent=1)


def _plain(value: Any) -> object:
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
