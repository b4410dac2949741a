"""Signs of life of long work on standard error: a bar for those who watch, lines for a file.

The command and the functions that take `progress=True` share them.
"""

import importlib.util
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Task

_PATIENCE = 2.0
"""Time until work first reports its progress where standard error is no terminal; s."""
_PAUSE = 10.0
"""Time between two such reports, and without a step from which on work says why; s."""
_MANY = 20
"""Fewest steps whose remaining time is shown: the lengths of a few steps differ too much."""


def note(text: str) -> None:
    """Writes a message about the run to standard error; a closed pipe does not end the work."""
    with suppress(BrokenPipeError):
        sys.stderr.write(text + "\n")


class Counter:
    """The progress of some work: how much is done, and what it is at.

    Work in threads begins and ends parts by their names; other work says what is done.
    """

    def __init__(
        self, total: int, why: str = "", num_programs: Callable[[], int] = lambda: 0
    ) -> None:
        self.total, self.done = total, 0
        self._why, self._message = why, ""
        self._num_programs = num_programs  # that have been compiled
        self._running: list[str] = []
        self._shares: dict[str, float] = {}
        self._lock = threading.Lock()
        self._first, self._num_steps = (0, 0.0), 0  # Where and when the pace is measured from
        self._begin = time.monotonic()
        self._live()

    def __call__(self, done: int, message: str = "") -> None:
        """Records what is done; the first call counts what an earlier run did."""
        with self._lock:
            self._moved(done)
            if message != self._message:
                self._message = message
                self._live()

    def began(self, name: str) -> None:
        """Records that a part has begun."""
        with self._lock:
            self._running.append(name)

    def within(self, name: str, share: float) -> None:
        """Records the share of a part that is done."""
        with self._lock:
            self._shares[name] = share
            self._live()

    def ended(self, name: str) -> None:
        """Records that a part has ended."""
        with self._lock:
            self._running.remove(name)
            self._moved(self.done + 1)

    def next(self, name: str) -> None:
        """Records that a part has begun, and the one before it has ended."""
        with self._lock:
            self._moved(self.done + len(self._running))
            self._running = [name]

    @property
    def share(self) -> float:
        """The work that is done, with the shares of the parts that are under way."""
        with self._lock:
            return self.done + sum((self._shares.get(name, 0.0) for name in self._running), 0.0)

    def _live(self) -> None:
        """Records a sign of life."""
        self._last, self._num_before = time.monotonic(), self._num_programs()

    def _moved(self, done: int) -> None:
        if done != self.done or self._num_steps == 0:
            self._live()
            # The first step compiles what the others use: its time says nothing of theirs.
            if self._num_steps < 2:
                self._first = done, self._last
            self._num_steps += 1
        self.done = done

    @property
    def place(self) -> str:
        """The part that the work is at, as "best Tukey, 3 of 8"; by its name where it is all."""
        with self._lock:
            count = f"{min(self.done + bool(self._running), self.total)} of {self.total}"
            name = self._running[0] if self._running else self._message
            # A share that stays says less than why.
            shows = name in self._shares and not self._is_stuck
            name += f" {self._shares[name]:.0%}" if shows else ""
        return f"{name}, {count}" if name and self.total > 1 else name or count

    @property
    def _is_stuck(self) -> bool:
        return time.monotonic() - self._last >= _PAUSE

    def __str__(self) -> str:
        now = time.monotonic()
        words = f"{self.place} after {now - self._begin:.0f} s"
        done, since = self._first
        # Steps that have stopped tell nothing of those to come.
        if done < self.done < self.total >= _MANY and not self._is_stuck:
            remaining = (self.total - self.done) * (now - since) / (self.done - done)
            words += f", about {remaining:.0f} s to go"
        # Without a step or a name there is no other sign of life.
        is_silent = not (self.done or self._running or self._message)
        reasons = [self._why] if self._why and (self._is_stuck or is_silent) else []
        ready = self._num_programs() - self._num_before
        if ready and now - self._last >= _PATIENCE:
            reasons.insert(0, f"{ready} program{'s' * (ready > 1)} compiled")
        return f"{words} ({'; '.join(reasons)})" if reasons else words


@contextmanager
def progress_bar(label: str, total: int, why: str = "") -> Iterator[Counter]:
    """Shows progress on standard error; yields the counter to move.

    A terminal shows a bar beside it, and so does a notebook that has widgets; a file gets a line
    now and then. Both have the elapsed time, and the remaining time of many steps.
    """
    from mishutter._core.compiling import num_programs

    counter = Counter(total, why, num_programs)
    console = _console()
    if console is None:
        with _lines(lambda: f"{label}: {counter}"):
            yield counter
        return
    from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
    from rich.table import Column
    from rich.text import Text

    class Place(ProgressColumn):
        """The part that the work is at, asked for whenever the bar is drawn."""

        def render(self, task: "Task") -> Text:
            bar.update(task.id, completed=counter.share)
            return Text(str(counter))

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=16),  # beside it a name has room on a terminal of 80 columns
        Place(Column(no_wrap=True, overflow="ellipsis")),
        console=console,
        transient=True,
    )
    with bar:
        bar.add_task(label, total=total)
        yield counter


@contextmanager
def reports(
    progress: "bool | Callable[..., None] | None",
    label: str,
    total: int,
    words: Callable[..., tuple[int, str]],
    why: str = "",
) -> "Iterator[Callable[..., None] | None]":
    """The function that work calls with its news: the caller's, one that moves a bar, or none."""
    if progress is True:
        with progress_bar(label, total, why) as counter:
            yield lambda *news: counter(*words(*news))
    else:
        yield progress if callable(progress) else None


@contextmanager
def counts(progress: bool, label: str, total: int, why: str = "") -> Iterator[Counter]:
    """A counter of named parts, which is shown if it is asked for."""
    if progress:
        with progress_bar(label, total, why) as counter:
            yield counter
    else:
        yield Counter(total)


@contextmanager
def working(label: str) -> Iterator[None]:
    """Shows on standard error that work without countable steps goes on."""
    console = _console()
    with _lines(lambda: f"{label} ...") if console is None else console.status(label):
        yield


def _console() -> "Console | None":
    """A console that can draw over what it drew: of a terminal, or of a notebook with widgets."""
    from rich.console import Console

    console = Console(file=sys.stderr)
    has_widgets = console.is_jupyter and importlib.util.find_spec("ipywidgets") is not None
    return console if console.is_terminal or has_widgets else None


@contextmanager
def _lines(text: Callable[[], str]) -> Iterator[None]:
    """Writes a line to standard error after a while, and again at intervals."""
    ended = threading.Event()

    def write() -> None:
        pause = _PATIENCE
        while not ended.wait(pause):
            note(text())
            pause = _PAUSE

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()
