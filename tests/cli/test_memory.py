"""A result is found again where nothing it depends on has changed, and only there."""

import subprocess
import sys
import time

import jax
import numpy as np
import pytest
from support.command_line import SMALL_SCENE, SMALL_SEARCH, environment

from mishutter import (
    ExpectedErrorLoss,
    HannShutter,
    ParabolicMotion,
    Scene,
    TukeyShutter,
    evaluate,
    example_picture,
    optimise,
    write_picture,
)
from mishutter.cli import memory
from mishutter.cli.memory import Memory
from mishutter.model.images import Picture

SCENE = Scene([0.0, 300.0], photon_rate=1e5, read_noise=4.0)
MOTION = ParabolicMotion(acceleration=1e5, half_exposure=1e-2)


@pytest.fixture
def shelf(tmp_path):
    """A folder of results of this test alone."""
    memory.SHELF.open(tmp_path / "results")
    yield memory.SHELF.folder
    memory.SHELF.folder = None


def found(memory, scene=SCENE, motion=MOTION, shutter=HannShutter(), **named):  # noqa: B008
    return memory.of("metrics", evaluate, scene, motion, shutter, watch={}, **named)


def test_the_same_question_is_not_worked_out_twice(shelf):
    """What comes back is bit for bit what was kept, and it is said when that was."""
    first, second = Memory(), Memory()
    given, again = found(first), found(second)
    assert first.recalled == {}
    assert set(second.recalled) == {"metrics"}
    assert str(second).startswith(f"metrics ({time.strftime('%Y-')}")
    assert type(again) is type(given)
    for x, y in zip(jax.tree.leaves(given), jax.tree.leaves(again), strict=True):
        assert np.array_equal(x, y)
        assert np.asarray(x).dtype == np.asarray(y).dtype


OTHERS = {
    "scene": Scene([0.0, 300.1], photon_rate=1e5, read_noise=4.0),
    "motion": ParabolicMotion(acceleration=1e5, half_exposure=1.0000001e-2),
    "shutter": TukeyShutter(1.0),
    "plan": None,
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_question_is(shelf, name):
    """A number of the scene or the motion, another shutter, an option."""
    found(Memory())
    other = Memory()
    found(other, **{name: OTHERS[name]})
    assert other.recalled == {}


def test_fresh_works_it_out_and_takes_the_place_of_what_was(shelf):
    """A wrong file is not read, and gone after."""
    found(Memory())
    (path,) = shelf.iterdir()
    right = path.read_bytes()
    path.write_bytes(b"wrong")
    found(Memory(fresh=True))
    assert path.read_bytes() == right


@pytest.mark.parametrize("damage", ["", "another", "cut", "a bit"])
def test_a_damaged_file_is_worked_out_anew(shelf, damage):
    """Empty, of something else, cut off, or with one bit turned, which would be another result."""
    given = found(Memory())
    (path,) = shelf.iterdir()
    whole = path.read_bytes()
    number = whole.index(np.asarray(given.expected_psnr).tobytes())
    turned = whole[:number] + bytes([whole[number] ^ 1]) + whole[number + 1 :]
    path.write_bytes({"": b"", "another": b"wrong", "cut": whole[:-10], "a bit": turned}[damage])
    again = Memory()
    assert float(found(again).expected_psnr) == float(given.expected_psnr)
    assert again.recalled == {}
    assert path.read_bytes() == whole


def test_what_is_not_the_packages_own_is_worked_out_every_time(shelf):
    """Its source may change without anybody's noticing."""
    asked = []
    for _ in range(2):
        Memory().of("a method", asked.append, 1, watch={})
        Memory().of("a function", lambda: asked.append(1), watch={})
    assert len(asked) == 4
    assert not shelf.exists()


def test_callbacks_are_called_while_it_works_and_never_kept(shelf):
    """They tell of progress: there is none in what was found before."""
    steps = []
    for _ in range(2):
        before = len(steps)
        design = Memory().of(
            "search",
            optimise,
            SCENE,
            MOTION,
            HannShutter(),
            loss=ExpectedErrorLoss(),
            max_steps=3,
            num_starts=2,
            free="half_exposure",
            watch={"progress": lambda *step: steps.append(step)},
        )
    assert len(steps) == before
    assert design.shutter == HannShutter()


def test_a_folder_that_cannot_be_made_costs_nothing_but_time(tmp_path):
    """A file is in its place."""
    (tmp_path / "file").write_text("")
    memory.SHELF.open(tmp_path / "file")
    try:
        assert np.isfinite(found(Memory()).expected_psnr)
    finally:
        memory.SHELF.folder = None


@pytest.mark.slow
def test_the_command_line_finds_again_what_has_not_changed(tmp_path):
    """The same tables; another picture under the same name is another question."""
    (tmp_path / "scene.toml").write_text(SMALL_SCENE)
    light = example_picture().light[:40, :200]
    write_picture(tmp_path / "photo.png", Picture(light))
    command = [sys.executable, "-m", "mishutter", "optimise", "scene.toml", *SMALL_SEARCH]
    own = environment(XDG_CACHE_HOME=str(tmp_path / "cache"))

    def asked(*more):
        call = [*command, *more]
        done = subprocess.run(
            call, cwd=tmp_path, env=own, capture_output=True, text=True, check=True
        )
        return done.stdout, done.stderr

    first, told = asked()
    assert "As found before" not in told
    again, told = asked("--out", "folder")
    assert again == first
    assert "As found before: search (" in told
    assert "comparison (" in told
    assert "photograph (" in told
    assert {"design.json", "photograph.png"} <= {x.name for x in (tmp_path / "folder").iterdir()}
    _, told = asked("--noise-seeds", "2")
    assert "search (" in told
    assert "photograph (" not in told
    write_picture(tmp_path / "photo.png", Picture(light[::-1, ::-1] ** 2))
    other, told = asked()
    assert other != first
    assert "As found before" not in told
    fresh, told = asked("--fresh")
    assert fresh == other
    assert "As found before" not in told
