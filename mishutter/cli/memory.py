"""What long work found, kept in the user's cache folder: no question is worked out twice."""

import pickle
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from typing import Any, TypeVar

from mishutter._core import Shelf

SHELF = Shelf(by_value=True, most_bytes=1 << 28)
_Result = TypeVar("_Result")


class Memory:
    """Results of earlier runs, each found again where all that it depends on is as it was.

    That is the arguments by value, the package's source, the libraries and the machine.

    Args:
        fresh: Whether everything is worked out anew, and takes the place of what was found.

    Attributes:
        recalled: What was found again, and when it had been worked out; seconds since 1970.
    """

    def __init__(self, *, fresh: bool = False) -> None:
        self._fresh = fresh
        self.recalled: dict[str, float] = {}

    def __str__(self) -> str:
        when = {name: datetime.fromtimestamp(t) for name, t in self.recalled.items()}
        return ", ".join(f"{name} ({t:%Y-%m-%d %H:%M})" for name, t in when.items())

    def of(
        self,
        name: str,
        work: Callable[..., _Result],
        *args: Any,
        watch: Mapping[str, Callable[..., None]],
        **kwargs: Any,
    ) -> _Result:
        """What `work` returns for these arguments, or returned in an earlier run.

        Args:
            name: What is worked out, for people.
            work: A function of the package.
            args: What it is given.
            watch: Callbacks by the names of its arguments: called only while it works.
            kwargs: What it is given by name.
        """
        path = SHELF.place_of((work, args, kwargs))
        if path is not None and not self._fresh:
            with suppress(Exception):  # whatever is wrong with a file, working it out mends it
                result = pickle.loads(SHELF.read(path))
                self.recalled[name] = path.stat().st_mtime
                return result
        result = work(*args, **kwargs, **watch)
        if path is not None:
            with suppress(Exception):  # what cannot be kept is worked out again
                SHELF.keep(path, pickle.dumps(result))
        return result
