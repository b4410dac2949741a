"""Programs kept on disk give the same bits in another process, and never another's."""

import inspect
import os
import subprocess
import sys
import time
from contextlib import nullcontext

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from mishutter import HannShutter, RectShutter, TukeyShutter
from mishutter._core import programs
from mishutter._core.programs import KeptProgram
from mishutter.blur.quadrature import lit_nodes
from mishutter.camera.noise import shot_electrons
from mishutter.model.shutters.base import profile_of

NODES, PROFILE, SHOTS = (inspect.unwrap(x) for x in (lit_nodes, profile_of, shot_electrons))
TAU = np.linspace(-1, 1, 9)


@pytest.fixture
def shelf(tmp_path):
    """A folder of programs of this test alone."""
    before = programs.SHELF.folder
    programs.SHELF.open(tmp_path / "programs")
    yield tmp_path / "programs"
    programs.SHELF.folder = before


def kept(shelf):
    return [path for path in shelf.rglob("*") if path.is_file()]


def without_compiling(function):
    program = KeptProgram(function)

    def compiled(*_):
        raise AssertionError("compiled though it was kept")

    program._compiled = compiled
    return program


def test_a_kept_program_is_loaded_and_gives_the_same_bits(shelf):
    """The second does not compile, nor trace, and its results have the same tree."""
    first = KeptProgram(NODES)(TukeyShutter(0.3), 64, np.dtype(np.float64))
    assert len(kept(shelf)) == 1
    again = without_compiling(NODES)(TukeyShutter(0.3), 64, np.dtype(np.float64))
    assert type(again) is type(first)
    for x, y in zip(first, again, strict=True):
        assert np.array_equal(x, y)
    plain = NODES(TukeyShutter(0.3), 64, np.dtype(np.float64))
    assert np.allclose(first.light, plain.light, rtol=1e-14)


def test_numbers_are_arguments_and_all_else_is_the_program(shelf):
    """Another taper is the same program; another length, size, dtype or kind is its own."""
    double, single = np.dtype(np.float64), np.dtype(np.float32)
    KeptProgram(NODES)(TukeyShutter(0.3), 64, double)
    without_compiling(NODES)(TukeyShutter(0.7), 64, double)
    for number, arguments in enumerate(
        [
            (TukeyShutter(0.3), 65, double),
            (TukeyShutter(0.3), 64, single),
            (TukeyShutter(np.float32(0.3)), 64, double),
            (HannShutter(), 64, double),
            (RectShutter(), 64, double),
        ]
    ):
        found = KeptProgram(NODES)(*arguments)
        assert len(kept(shelf)) == number + 2
        expected = NODES(*arguments)
        assert found.light.dtype == expected.light.dtype
        assert np.allclose(found.light, expected.light, rtol=1e-6)


def test_a_class_of_ones_own_is_not_kept(shelf):
    """Its source may change without the package's doing so."""

    class Own(eqx.Module):
        def transmittance(self, tau):
            return jnp.abs(tau)

        def efficiency(self):
            return jnp.asarray(0.5)

    found, _ = KeptProgram(PROFILE)(Own(), TAU)
    assert np.array_equal(found, np.abs(TAU))
    assert kept(shelf) == []


def test_a_program_that_calls_back_is_not_kept(shelf):
    """What it calls lives in this process."""
    found = KeptProgram(SHOTS)(jax.random.key(3), jnp.full(50, 100.0))
    assert np.array_equal(found, shot_electrons(jax.random.key(3), jnp.full(50, 100.0)))
    assert kept(shelf) == []


@pytest.mark.parametrize("damage", [b"", b"not a program", None])
def test_a_damaged_file_is_made_anew(shelf, damage):
    """Empty, of something else, or cut off."""
    first, _ = KeptProgram(PROFILE)(HannShutter(), TAU)
    (path,) = kept(shelf)
    path.write_bytes(path.read_bytes()[:1000] if damage is None else damage)
    again, _ = KeptProgram(PROFILE)(HannShutter(), TAU)
    assert np.array_equal(first, again)
    without_compiling(PROFILE)(HannShutter(), TAU)


def test_what_comes_from_the_cache_of_jax_is_not_kept(shelf, tmp_path, monkeypatch):
    """It lacks code when it is written again; another thread may have JAX use its cache."""
    monkeypatch.setattr(programs, "_PAST_THE_CACHE", nullcontext())
    cache = "jax_persistent_cache_min"
    names = "jax_enable_compilation_cache", "jax_compilation_cache_dir"
    names += f"{cache}_compile_time_secs", f"{cache}_entry_size_bytes"
    before = [programs.setting(name) for name in names]
    try:
        for name, value in zip(names, (True, str(tmp_path / "jax"), 0.0, -1), strict=True):
            jax.config.update(name, value)
        compilation_cache.reset_cache()
        for _ in range(2):
            for path in kept(shelf):
                path.unlink()
            jax.clear_caches()
            first, _ = KeptProgram(PROFILE)(HannShutter(), TAU)
        assert list((tmp_path / "jax").iterdir())
        again, _ = without_compiling(PROFILE)(HannShutter(), TAU)
        assert np.array_equal(first, again)
    finally:
        for name, value in zip(names, before, strict=True):
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def test_a_folder_that_cannot_be_made_costs_nothing_but_time(tmp_path):
    """A file is in its place."""
    (tmp_path / "file").write_text("")
    before = programs.SHELF.folder
    programs.SHELF.open(tmp_path / "file")
    try:
        found, efficiency = KeptProgram(PROFILE)(HannShutter(), TAU)
    finally:
        programs.SHELF.folder = before
    assert np.allclose(found, np.cos(np.pi * TAU / 2) ** 2)
    assert np.isclose(efficiency, 0.5)


def test_programs_long_unused_are_removed(shelf):
    """A folder of last year goes, one of today stays."""
    old, recent = shelf / "old", shelf / "recent"
    for folder in (old, recent):
        folder.mkdir(parents=True)
        (folder / "program").write_text("")
    last_year = time.time() - 365 * 24 * 3600
    os.utime(old, (last_year, last_year))
    KeptProgram(PROFILE)(HannShutter(), TAU)
    assert not old.exists()
    assert recent.exists()


SCRIPT = """
import sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
from mishutter import example_scene, evaluate, HannShutter, ParabolicMotion
from mishutter.camera.noise import shot_electrons
from mishutter._core.programs import SHELF, KeptProgram
SHELF.open(Path(sys.argv[1]))
if sys.argv[2] == "again":
    KeptProgram._compiled = None
motion = ParabolicMotion(acceleration=5e5, half_exposure=9e-3)
found = evaluate(example_scene(), motion, HannShutter())
print(*(float(x).hex() for x in jax.tree.leaves(found)))
"""


def test_another_process_gives_the_same_bits(tmp_path):
    """Metrics of a design, by programs that it did not compile."""
    arguments = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    printed = [
        subprocess.run([*arguments, which], capture_output=True, text=True, check=True).stdout
        for which in ("first", "again")
    ]
    assert printed[0] == printed[1] != ""
