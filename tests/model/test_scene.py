"""A scene made in Python is refused where it is made, by the argument that is wrong."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from support.command_line import environment
from support.helpers import ROUNDING

from mishutter import (
    Limits,
    Optics,
    Scene,
    Texture,
    compare,
    evaluate,
    optimise,
)
from mishutter.model.scene import picture_power, power_on_grid

LIGHT = {"photon_rate": 1e5, "read_noise": 3.0}


@pytest.mark.parametrize(
    ("power", "message"),
    [
        (np.ones((2, 3)), r"must be one row of at least one value; got shape \(2, 3\)"),
        (2.0, r"must be one row of at least one value; got shape \(\)"),
        ([], r"must be one row of at least one value; got shape \(0,\)"),
        ([0.3, -0.1], "must be at least 0; got"),
        ([0.0, 0.0, 0.0], "must hold some power where the deviation is not 0; got 0.0"),
    ],
)
def test_spectra_that_are_none(power, message):
    """A power spectrum is one row, and no picture with contrast is without power."""
    with pytest.raises(ValueError, match=message):
        Scene([0.0], **LIGHT, picture=Texture(power_spectrum=power))


def test_a_picture_without_contrast_has_no_power():
    """What `row_power_spectrum` finds of one grey is a scene."""
    scene = Scene([0.0], **LIGHT, picture=Texture(power_spectrum=np.zeros(7), deviation=0.0))
    assert not np.any(scene.picture.power_spectrum)


@pytest.mark.parametrize(
    ("power", "cutoff", "first"), [(None, 9e-4, "0.000977"), (np.arange(8) > 5, 0.21, "0.376")]
)
def test_optics_that_pass_nothing_of_the_picture(power, cutoff, first):
    """A picture that the lens leaves nothing of is refused, not restored without error."""
    message = f"pass some of .*, whose power begins at {first} cycles/px; got a cutoff of {cutoff}"
    with pytest.raises(ValueError, match=message):
        Scene(
            [0.0],
            **LIGHT,
            picture=Texture(power_spectrum=power),
            optics=Optics(cutoff_frequency=cutoff),
        )
    Scene(
        [0.0],
        **LIGHT,
        picture=Texture(power_spectrum=power, deviation=0.0),
        optics=Optics(cutoff_frequency=cutoff),
    )
    Scene(
        [0.0], **LIGHT, picture=Texture(power_spectrum=power), optics=Optics(cutoff_frequency=0.38)
    )


@pytest.mark.parametrize("name", ["given_motion", "limits", "picture", "optics", "sensor"])
def test_parts_that_are_something_else(name):
    """A part of the wrong kind is refused by name, also where annotations are not checked."""
    scene = Scene([0.0], **LIGHT)
    object.__setattr__(scene, name, 3)
    argument = name.removeprefix("given_")
    with pytest.raises(ValueError, match=rf"`Scene\({argument}=...\)` must be .*; got 3"):
        scene.__check_init__()


@pytest.mark.parametrize("scale", [1e-200, 0.75, 3.0, 7e8])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weights_are_divided_by_their_sum(scale, dtype):
    """Counts and shares of any scale give one scene; a traced one too."""
    weights = np.array([0.2, 0.3, 0.5], np.float64)
    given = (scale * weights).astype(dtype) if scale > 1e-30 else scale * weights
    speeds = np.array([3.0, -7.0, 19.0], given.dtype)
    made = Scene(speeds, given, **LIGHT)
    traced = jax.jit(lambda w: Scene(speeds, w, **LIGHT).weights)(given)
    tolerance = 8 * np.finfo(given.dtype).eps
    np.testing.assert_allclose(np.asarray(made.weights), weights, rtol=tolerance)
    np.testing.assert_allclose(np.asarray(traced), weights, rtol=tolerance)
    assert np.array_equal(np.asarray(made.without_metadata().weights), np.asarray(made.weights))


@pytest.mark.parametrize(
    ("stroke", "top", "half"), [(45.0, 20350.0, 4.5e-3), (45.0, 20.0, 0.05), (0.3, 2e4, 1e-3)]
)
def test_a_scene_without_a_motion_has_the_fullest(stroke, top, half):
    """It uses up the stroke and the top speed, or what the exposures allow, beside its pan."""
    limits = Limits(
        max_stroke=stroke, max_top_speed=top, min_half_exposure=1e-3, max_half_exposure=0.05
    )
    motion = Scene([0.0, 700.0], **LIGHT, limits=limits).motion
    assert float(motion.half_exposure) == pytest.approx(half)
    shares = float(motion.stroke) / stroke, float(motion.top_speed) / top
    assert max(shares) == pytest.approx(1)


def test_a_picture_may_be_a_path():
    """A path is kept as text, which a design file holds."""
    path = Path("some") / "photo.png"
    assert Scene([0.0], **LIGHT, picture=Texture(path=path)).picture.path == str(path)


def test_a_scene_is_loaded_by_text_or_path(tmp_path):
    """A file is named by either, also where annotations are checked."""
    path = tmp_path / "scène 1.toml"
    path.write_text(
        "[speeds]\nlist_px_per_s = [7]\n[light]\nphoton_rate_per_s = 3e5\n"
        "[sensor]\nread_noise_e = 2\n"
    )
    for place in (path, str(path)):
        assert float(Scene.load(place).read_noise) == 2


@pytest.mark.parametrize("place", ["scene.toml", Path("scenes") / "dim.toml", None])
@pytest.mark.parametrize("function", [optimise, evaluate, compare])
def test_a_path_is_no_scene(function, place):
    """The line says what reads a file; where annotations are not checked it comes before all."""
    with pytest.raises(ValueError, match=r"`scene` must be a `Scene`, as `Scene\.load\(path\)`"):
        inspect.unwrap(function)(place, None, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "line", "others"),
    [
        ("'scene.toml'", "`Scene.load(path)`", set()),
        (
            "mishutter.Scene.any_direction(900.0, photon_rate=1.0, read_noise=1.0)",
            "`scene` must move along one axis here",
            {
                "best_in_plane",
                "exposures_psnr",
                "Exposures.stage_paths",
                "restore_frames",
                "simulate_frames",
            },
        ),
    ],
    ids=["path", "plane"],
)
def test_every_public_function_refuses_what_it_cannot_serve(scene, line, others):
    """A path in place of a scene, or any direction where there is one axis; all of them alike.

    Functions, methods and losses answer in a process that checks no annotations.
    """
    output = subprocess.run(
        [sys.executable, "-c", _ALL_THAT_TAKE_A_SCENE.replace("A_SCENE", scene)],
        capture_output=True,
        text=True,
        check=True,
        env=environment(),
    ).stdout
    answers = dict(line.split(" -> ") for line in output.splitlines())
    assert {"optimise", "light_map", "sweep", "ExpectedErrorLoss.__call__"} < set(answers)
    wrong = {name for name, answer in answers.items() if line not in answer}
    assert wrong == others, {name: answers[name] for name in wrong}


_ALL_THAT_TAKE_A_SCENE = """
import inspect, sys
import numpy as np
import mishutter
from mishutter import HannShutter, ParabolicMotion

given = {
    "motion": ParabolicMotion(acceleration=1e4, half_exposure=0.01),
    "shutter": HannShutter(),
    "captured": np.ones((8, 90)),
    "scene": A_SCENE,
    "scenes": A_SCENE,
    "accelerations": [1e4],
    "half_exposures": [0.01],
    "shutters": {"Hann": HannShutter()},
}


def answer(function, names, **others):
    try:
        function(**{name: (given | others).get(name) for name in names})
    except Exception as error:
        return str(error).splitlines()[0]
    return "nothing"


def takes_scene(function):
    parameters = inspect.signature(function).parameters.values()
    needed = [p.name for p in parameters if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    return needed if {"scene", "scenes"} & set(needed) else None


for name in dir(mishutter):
    thing = getattr(mishutter, name)
    if inspect.isfunction(thing):
        if needed := takes_scene(thing):
            print(name, answer(thing, needed), sep=" -> ")
        continue
    if inspect.isabstract(thing):
        continue
    methods = inspect.getmembers(thing, inspect.isfunction) if inspect.isclass(thing) else ()
    for method, function in methods:
        is_public = method == "__call__" or method[0] != "_"
        needed = takes_scene(function) if is_public else None
        if needed and "response" not in needed:  # what an implementer is handed has been looked at
            # Of no numbers: the scene is looked at first.
            itself = tuple.__new__(thing) if issubclass(thing, tuple) else object.__new__(thing)
            print(f"{name}.{method}", answer(function, needed, self=itself), sep=" -> ")
"""


def test_the_fastest_object_is_one_that_occurs():
    """By size, whichever way it goes, and in a compiled function too."""
    scene = Scene([-900.0, 400.0, 5e4], [0.3, 0.7, 0.0], **LIGHT)
    assert float(scene.max_speed) == float(jax.jit(lambda s: s.max_speed)(scene)) == 900


MISTAKES = {
    "no-speed": (lambda: Scene([], **LIGHT), "`Scene(speeds=...)` must be one row of at least one"),
    "table": (
        lambda: Scene(np.array([[3.0]]), **LIGHT),
        "must be one row of at least one speed; got shape (1, 1).",
    ),
    "speed-nan": (lambda: Scene([3.0, np.nan], **LIGHT), "`Scene(speeds=...)` must be finite; got"),
    "lengths": (
        lambda: Scene([3.0, 7.0], [0.2, 0.3, 0.5], **LIGHT),
        "`Scene(weights=...)` must have shape (2,); got (3,)",
    ),
    "weights-off": (
        lambda: Scene([3.0, 7.0], [0.0, 0.0], **LIGHT),
        "`Scene(weights=...)` must hold one above 0; got",
    ),
    "weight-negative": (
        lambda: Scene([3.0, 7.0], [-0.2, 1.2], **LIGHT),
        "`Scene(weights=...)` must be at least 0; got [-0.2, 1.2]",
    ),
    "dark": (
        lambda: Scene([3.0], photon_rate=-2.0, read_noise=3.0),
        "`Scene(photon_rate=...)` must be at least 0; got -2.0",
    ),
    "noise-nan": (
        lambda: Scene([3.0], photon_rate=2.0, read_noise=np.nan),
        "`Scene(read_noise=...)` must be finite; got nan",
    ),
    "two-means": (
        lambda: Scene([3.0], **LIGHT, picture=Texture(mean_level=np.array([0.2, 0.3]))),
        "`Texture(mean_level=...)` must be a scalar; got shape (2,).",
    ),
    "two-strokes": (
        lambda: Limits(max_stroke=np.array([1.0, 2.0])),
        "`Limits(max_stroke=...)` must be a scalar; got",
    ),
    "no-top-speed": (
        lambda: Limits(max_top_speed=0.0),
        "`Limits(max_top_speed=...)` must be above 0; got 0.0",
    ),
    "exposures-reversed": (
        lambda: Limits(min_half_exposure=0.03, max_half_exposure=0.02),
        "`Limits(min_half_exposure=...)` must be at most max_half_exposure = 0.02 s; got 0.03",
    ),
    "range-reversed": (
        lambda: Scene.uniform(max_speed=-5.0, min_speed=3.0, **LIGHT),
        "`Scene.uniform(max_speed=...)` must be at least 3 px/s; got -5.0",
    ),
    "range-endless": (
        lambda: Scene.uniform(max_speed=np.inf, **LIGHT),
        "`Scene.uniform(max_speed=...)` must be finite; got inf",
    ),
    "range-of-none": (
        lambda: Scene.uniform(max_speed=5.0, num_speeds=0, **LIGHT),
        "`Scene.uniform(num_speeds=...)` must be a positive integer; got 0",
    ),
    "range-of-one": (
        lambda: Scene.uniform(max_speed=2800.0, num_speeds=1, **LIGHT),
        "`Scene.uniform(num_speeds=...)` must be at least 2, for speeds from -2800 to 2800 px/s; "
        "got 1",
    ),
}


@pytest.mark.parametrize("slug", MISTAKES)
def test_mistakes(slug):
    """Each is one line with the argument, what must hold and what came."""
    make, message = MISTAKES[slug]
    with pytest.raises(ValueError, match=re.escape(message)):
        make()


@pytest.mark.parametrize(
    ("given", "speeds"),
    [
        ({"max_speed": 310.0, "num_speeds": 4}, np.arange(-3, 4, 2) * 310 / 3),
        ({"max_speed": 310.0, "min_speed": -70.0, "num_speeds": 3}, [-70.0, 120.0, 310.0]),
        ({"max_speed": 310.0, "min_speed": 310.0, "num_speeds": 1}, [310.0]),
        ({"max_speed": 310.0}, np.arange(-4, 5) * 77.5),
    ],
)
def test_a_range_of_speeds(given, speeds):
    """Both ways unless it begins elsewhere, in equal steps of equal weight."""
    scene = Scene.uniform(**given, **LIGHT)
    np.testing.assert_allclose(scene.speeds, speeds, rtol=1e-14)
    np.testing.assert_allclose(scene.weights, np.full(len(speeds), 1 / len(speeds)), rtol=1e-14)


def test_the_mean_power_is_the_variance():
    """Of a scene's own spectrum through a cutoff, by NumPy and where it is traced."""
    power = 1 / np.linspace(0.02, 0.5, 48) ** 1.3
    light = {"photon_rate": 1e5, "read_noise": 3.0, "optics": Optics(cutoff_frequency=0.31)}
    scene = Scene([0.0, 40.0], picture=Texture(power_spectrum=power, deviation=0.17), **light)
    known = power_on_grid(scene, 96)
    assert np.isclose(np.mean(known), 0.17**2, rtol=ROUNDING)
    assert not np.any(known[np.arange(96) + 0.5 > 0.31 * 192])
    traced = jax.jit(lambda s: picture_power(s, 96, np.dtype(np.float64)))(scene)
    np.testing.assert_allclose(traced, known, rtol=1e-13)
