"""JAX's cache of compiled programs mends itself: an entry that cannot be read is written anew."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from mishutter._core.compiling import keep_compiled_programs, mend_compilation_cache


@pytest.fixture
def cache(tmp_path):
    """A cache of this test's own."""
    before = jax.config.jax_compilation_cache_dir
    compilation_cache.set_cache_dir(str(tmp_path))
    compilation_cache.reset_cache()
    yield tmp_path
    compilation_cache.set_cache_dir(before)
    compilation_cache.reset_cache()


SIZE = 7
"""Of the vector whose program is damaged."""


def ninth_root_of_sum(x):
    return jnp.sum(x) ** (1 / 9)


def entries(folder):
    """The contents of the program's entries."""
    return {path: path.read_bytes() for path in folder.glob("jit_ninth_root_of_sum-*-cache")}


def computed(size):
    """What a process that has just begun finds in the cache, or compiles."""
    jax.clear_caches()
    x = np.linspace(0.3, 2.9, size)
    assert np.isclose(jax.jit(ninth_root_of_sum)(x), np.sum(x) ** (1 / 9))


def while_mending(call):
    mend_compilation_cache()
    call()


def is_whole(path):
    """Whether the entry is read, and not written anew."""
    before = path.stat().st_mtime_ns
    computed(SIZE)
    return path.stat().st_mtime_ns == before


def overwritten(whole):
    return whole[:40] + b"damage" + whole[46:]


@pytest.mark.parametrize(
    "damaged", [lambda whole: whole[:-9], lambda whole: b"", overwritten], ids=["cut", "empty", ""]
)
def test_an_entry_that_cannot_be_read_is_written_anew(cache, damaged):
    """Without a word, as often as it happens; the program's result is right meanwhile."""
    computed(SIZE)
    ((path, whole),) = entries(cache).items()
    for _ in range(2):
        assert is_whole(path)
        path.write_bytes(damaged(whole))
        assert not is_whole(path)
    assert is_whole(path)


def test_entries_of_one_function_are_all_written_anew(cache):
    """A full disk cut the programs for several shapes."""
    sizes = (5, SIZE, 11)
    for size in sizes:
        computed(size)
    whole = entries(cache)
    assert len(whole) == len(sizes)
    for path, content in whole.items():
        path.write_bytes(content[: len(content) // 3])
    for size in sizes:
        computed(size)
    assert entries(cache).keys() == whole.keys()
    assert all(len(content) > len(whole[path]) / 2 for path, content in entries(cache).items())


def test_an_entry_that_cannot_be_deleted_is_said(cache):
    """JAX's own warning stays where nothing can be done about an entry."""
    computed(SIZE)
    (path,) = entries(cache)
    path.unlink()
    path.mkdir()
    with pytest.warns(UserWarning, match="Error reading persistent compilation cache entry"):
        while_mending(lambda: computed(SIZE))


def test_other_warnings_are_left_alone():
    """Only that of an unreadable entry is taken."""
    with pytest.warns(UserWarning, match="of something else"):
        while_mending(lambda: warnings.warn("of something else", stacklevel=1))


@pytest.fixture
def unset(cache, monkeypatch, tmp_path):
    """JAX without a folder for programs, and a user's cache folder of this test's own."""
    names = "persistent_cache_min_compile_time_secs", "persistent_cache_min_entry_size_bytes"
    before = {f"jax_{name}": getattr(jax.config, f"jax_{name}") for name in names}
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "users"))
    yield tmp_path / "users" / "mishutter" / "jax"
    for name, value in before.items():
        jax.config.update(name, value)


def test_a_session_of_python_keeps_its_programs(unset):
    """Also where one was compiled before, when JAX had nowhere to keep it."""
    computed(SIZE)
    assert keep_compiled_programs() == unset
    assert not entries(unset)
    computed(SIZE)
    (path,) = entries(unset)
    assert is_whole(path)


def test_a_folder_that_the_user_chose_stays(unset, tmp_path):
    """It is named, and the user's cache folder takes nothing."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "chosen"))
    assert keep_compiled_programs() == tmp_path / "chosen"
    computed(SIZE)
    assert not unset.exists()


def test_nothing_is_kept_where_others_may_write(unset, tmp_path):
    """A file is in the way of the user's cache folder."""
    (tmp_path / "users").write_text("in the way")
    assert keep_compiled_programs() is None
    assert jax.config.jax_compilation_cache_dir is None
    computed(SIZE)
