"""Signs of life: a counter that names what it is at, in lines, in a bar, and for nobody."""

import io
import re
import sys
import threading
import time

import jax
import numpy as np
import pytest
from rich.console import Console

import mishutter as ms
from mishutter._core import progress
from mishutter._core.compiling import num_programs
from mishutter._core.progress import Counter, counts, progress_bar, reports, working
from mishutter.sweeps.trade_offs import best_snapshots


def line_once(capsys, others, wanted):
    """Waits for a line on standard error; before it come those that match `others`."""
    end = time.monotonic() + 240
    while time.monotonic() < end:
        out, err = capsys.readouterr()
        assert out == ""
        for line in err.splitlines():
            if re.fullmatch(wanted, line):
                return
            assert re.fullmatch(others, line), line
        time.sleep(0.01)
    raise AssertionError(wanted)


@pytest.fixture
def impatient(monkeypatch):
    """No work of a test is quick at a patience of 0.05 s."""
    monkeypatch.setattr(progress, "_PAUSE", 0.05)
    monkeypatch.setattr(progress, "_PATIENCE", 0.05)


def test_work_in_a_pipe_says_now_and_then_how_long_it_takes(impatient, monkeypatch, capsys):
    """Lines on standard error, none while it is quick, with a time to go once one is known."""
    monkeypatch.setattr(progress, "_PATIENCE", 3600)
    with progress_bar("searching", 40) as update:
        update(7, "loss 1")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "_PATIENCE", 0.05)
    with progress_bar("searching", 40) as update:
        update(7, "loss 1")
        told = r"searching: loss 1, 7 of 40 after \d+ s"
        line_once(capsys, r"searching: 0 of 40 after \d+ s", told)
        update(9, "loss 0.9")
        ended = r"searching: loss 0.9, 9 of 40 after \d+ s"
        line_once(capsys, told, ended)
    capsys.readouterr()
    with progress_bar("comparing", 8) as update:
        update(2)
        update(6)
        line_once(capsys, r"comparing: [02] of 8 after \d+ s", r"comparing: 6 of 8 after \d+ s")
    capsys.readouterr()
    with working("planning"):
        line_once(capsys, r"planning \.\.\.", r"planning \.\.\.")


def test_a_counter_names_what_it_is_at():
    """The first of the parts that have begun, and its number, which is never more than all."""
    counter = Counter(3)
    assert counter.place == "0 of 3"
    counter.began("rect")
    counter.began("best Tukey")
    assert counter.place == "rect, 1 of 3"
    counter.ended("rect")
    assert counter.place == "best Tukey, 2 of 3"
    counter.began("Hann")
    counter.ended("Hann")
    assert counter.place == "best Tukey, 3 of 3"
    counter.ended("best Tukey")
    assert counter.place == "3 of 3"
    in_turn = Counter(2)
    in_turn.next("50% still")
    assert in_turn.place == "50% still, 1 of 2"
    in_turn.next("70% still")
    assert in_turn.place == "70% still, 2 of 2"
    in_turn.next("one that was not counted")
    assert in_turn.place == "one that was not counted, 2 of 2"


def test_work_of_one_part_is_told_by_its_name():
    """A count of 1 of 1 would say that it is done."""
    counter = Counter(1)
    counter.began("ways of the stage")
    counter.within("ways of the stage", 0.47)
    assert counter.place == "ways of the stage 47%"
    assert Counter(1).place == "0 of 1"


def test_a_counter_that_stays_says_why(monkeypatch):
    """Before the first step, and after ten seconds without one, the last that is counted too."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    counter = Counter(4, "programs are compiled")
    assert str(counter) == "0 of 4 after 0 s (programs are compiled)"
    counter.began("rect")
    now[0] += 9.75
    assert str(counter) == "rect, 1 of 4 after 10 s"
    now[0] += 0.5
    assert str(counter) == "rect, 1 of 4 after 10 s (programs are compiled)"
    counter.ended("rect")
    assert str(counter) == "1 of 4 after 10 s"
    now[0] += 25
    assert str(counter) == "1 of 4 after 35 s (programs are compiled)"
    counter(4, "loss 0.25")
    now[0] += 25
    assert str(counter) == "loss 0.25, 4 of 4 after 60 s (programs are compiled)"
    counter(4, "loss 0.24")
    assert str(counter) == "loss 0.24, 4 of 4 after 60 s"


def test_a_counter_that_stays_promises_no_end(monkeypatch):
    """The pace of steps that have stopped tells nothing of those to come."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    counter = Counter(400, "compiling")
    counter(0)
    now[0] += 36
    counter(50)
    assert str(counter) == "50 of 400 after 36 s"  # of which most went into compiling
    now[0] += 2
    counter(100)
    assert str(counter) == "100 of 400 after 38 s, about 12 s to go"
    now[0] += 11
    assert str(counter) == "100 of 400 after 49 s (compiling)"


def test_programs_that_are_compiled_are_a_sign_of_life(monkeypatch):
    """They are counted from the last step on, once that is two seconds ago."""
    now, ready = [1000.0], [5]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    counter = Counter(2, "a long search", lambda: ready[0])
    counter.began("best snapshot")
    now[0], ready[0] = now[0] + 1.5, 6
    assert str(counter) == "best snapshot, 1 of 2 after 2 s"
    now[0] += 1.5
    assert str(counter) == "best snapshot, 1 of 2 after 3 s (1 program compiled)"
    now[0], ready[0] = now[0] + 9, 18
    words = "best snapshot, 1 of 2 after 12 s (13 programs compiled; a long search)"
    assert str(counter) == words
    counter.within("best snapshot", 0.25)
    assert str(counter) == "best snapshot 25%, 1 of 2 after 12 s"


def test_programs_are_counted_as_they_are_compiled():
    """Each new one once."""
    before = num_programs()
    triple = jax.jit(lambda x: 3 * x)
    triple(np.ones(7))
    triple(np.ones(7))
    assert num_programs() == before + 1


def test_a_counter_moves_within_a_part(monkeypatch):
    """A long part says its share, and is not said to be stuck while that grows."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    counter = Counter(4, "compiling (first run only)")
    counter.began("best still burst")
    counter.began("rect")
    counter.ended("rect")
    now[0] += 9.75
    counter.within("best still burst", 0.37)
    now[0] += 9.75
    assert counter.place == "best still burst 37%, 2 of 4"
    assert counter.share == pytest.approx(1.37)
    counter.ended("best still burst")
    assert counter.share == 2.0


def test_a_counter_is_moved_by_threads():
    """No part of many is lost."""
    counter = Counter(400)

    def work(first):
        for index in range(first, first + 100):
            counter.began(str(index))
            counter.ended(str(index))

    threads = [threading.Thread(target=work, args=(100 * k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counter.place == "400 of 400"


class Terminal(io.StringIO):
    """Standard error of someone who watches."""

    def isatty(self):
        return True


def test_a_terminal_has_a_bar(monkeypatch):
    """It shows the label, the place and the time, and is gone when the work is done."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    with progress_bar("comparing", 8) as counter:
        counter.began("best Tukey")
        end = time.monotonic() + 60
        while "best Tukey, 1 of 8" not in terminal.getvalue() and time.monotonic() < end:
            time.sleep(0.02)
    shown = terminal.getvalue()
    assert "comparing" in shown
    assert "best Tukey, 1 of 8 after 0 s" in shown


@pytest.mark.parametrize("has_widgets", [True, False])
def test_a_notebook_has_a_bar_where_it_can_draw_one(has_widgets, monkeypatch):
    """Rich draws by widgets there; without them lines come, and no warning."""
    monkeypatch.setattr(Console, "is_jupyter", True, raising=False)
    monkeypatch.setattr(
        Console,
        "__setattr__",
        lambda self, name, value: (
            None if name == "is_jupyter" else object.__setattr__(self, name, value)
        ),
    )
    found = object() if has_widgets else None
    monkeypatch.setattr("importlib.util.find_spec", lambda name: found)
    assert (progress._console() is not None) == has_widgets


def test_news_go_to_the_caller_the_bar_or_nobody(impatient, capsys):
    """By the argument: a function, True, or none."""
    heard = []
    words = {"label": "searching", "total": 9, "words": lambda step, loss: (step, f"loss {loss}")}
    for asked in (None, False):
        with reports(asked, **words) as news:
            assert news is None
    with reports(lambda step, loss: heard.append((step, loss)), **words) as news:
        news(3, 0.75)
    assert heard == [(3, 0.75)]
    assert capsys.readouterr().err == ""
    with reports(True, **words) as news:
        news(3, 0.75)
        line_once(capsys, r".*", r"searching: loss 0.75, 3 of 9 after \d+ s")
    with counts(False, "comparing", 4) as counter:
        counter.next("rect")
        time.sleep(0.15)
    assert "comparing" not in capsys.readouterr().err
    with counts(True, "comparing", 4) as counter:
        counter.next("rect")
        line_once(capsys, r".*", r"comparing: rect, 1 of 4 after \d+ s")


@pytest.mark.slow
def test_functions_show_what_they_are_at(impatient, capsys):
    """Each that takes `progress=True`, in its own words; none says a word without."""
    limits = ms.Limits(max_stroke=21, max_half_exposure=0.013)
    scene = ms.Scene.uniform(max_speed=900.0, photon_rate=7e4, read_noise=7, limits=limits)
    grid = {"accelerations": [3e4, 9e4], "half_exposures": [3e-3, 7e-3]}
    calls = {
        "searching": lambda shown: ms.optimise(scene, num_starts=2, max_steps=9, progress=shown),
        "sweeping": lambda shown: ms.sweep(scene, **grid, progress=shown),
        "best snapshots": lambda shown: best_snapshots(scene, [3e4, 7e4], progress=shown),
        "comparing": lambda shown: ms.compare(scene, scene.motion, progress=shown),
    }
    for label, call in calls.items():
        jax.clear_caches()  # a program that is compiled once more takes its time
        call(True)
        lines = capsys.readouterr().err.splitlines()
        assert lines
        call(False)
        assert capsys.readouterr().err == ""
        assert all(re.match(rf"{label}: .*\d+ of \d+.* after \d+ s", line) for line in lines)
