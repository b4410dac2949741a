"""Pictures whose things move along their columns: those of rows, with both exchanged.

Every function that takes a picture and a scene is held to it to the last digit.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION
from support.photographs import photograph

from mishutter import (
    Exposures,
    Footage,
    Layer,
    Layers,
    Limits,
    Picture,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    TotalVariationDecoder,
    TukeyShutter,
    capture_and_restore,
    deconvolve,
    estimate_speed,
    example_picture,
    restore_photograph,
    row_power_spectrum,
    simulate_capture,
    write_picture,
)
from mishutter.hardware.calibration.measurements import TargetPicture, read_measurements
from mishutter.model.scene import read_scene, scene_text
from mishutter.pictures.images import transposed
from mishutter.report.plots import plot_photograph

GIVEN = {"photon_rate": 1e5, "read_noise": 4.0, "limits": Limits(max_stroke=30.0)}
ACROSS, DOWN = (
    Scene([-700.0, 0.0, 450.0], **GIVEN, sensor=Sensor(axis=axis)) for axis in ("rows", "columns")
)
CAMERA = MOTION, TukeyShutter(0.5)
LIGHT = example_picture().light[100:150, 200:310]


def exchanged(light):
    """Rows and columns exchanged, by other means than the package's."""
    light = np.asarray(light)
    return np.moveaxis(light, 1, 0) if light.ndim <= 3 else np.moveaxis(light, 2, 1)


def subject(kind, light):
    """A photograph, layers or footage of some light."""
    matte = np.ones((12, 17), np.float32) * 0.7
    if kind == "layers":
        front = Layer(Picture(light[5:17, 9:26], matte), 450.0, left=31, top=7)
        return Layers((Layer(Picture(light), -700.0), front))
    return {"photograph": light, "frames": Footage.of([light, 0.5 * light, light**2])}[kind]


def subject_down(kind, light):
    """The same of light whose rows and columns are exchanged."""
    if kind == "layers":
        matte = np.ones((17, 12), np.float32) * 0.7
        front = Layer(Picture(light[9:26, 5:17], matte), 450.0, left=7, top=31)
        return Layers((Layer(Picture(light), -700.0), front))
    return subject(kind, light)


@pytest.mark.parametrize("kind", ["photograph", "layers", "frames"])
def test_a_capture_down_is_that_across_with_rows_and_columns_exchanged(kind):
    """Blur, noise and borders alike, of every kind of subject."""
    key = jax.random.key(3)
    across = simulate_capture(subject(kind, LIGHT), ACROSS, *CAMERA, key=key)
    down = simulate_capture(subject_down(kind, exchanged(LIGHT)), DOWN, *CAMERA, key=key)
    np.testing.assert_array_equal(down, exchanged(across))
    assert not np.array_equal(down, simulate_capture(subject(kind, LIGHT), ACROSS, *CAMERA).mT)


def test_a_capture_down_is_traced_as_one_across_is():
    """Within `jit`, of a photograph with a displacement and the columns that are recorded whole."""
    options = {"speed": 450.0, "displacement": 0.3, "border": "scene", "key": jax.random.key(3)}
    across, down = (
        jax.jit(lambda light, scene=scene: simulate_capture(light, scene, *CAMERA, **options))(seen)
        for scene, seen in ((ACROSS, LIGHT), (DOWN, exchanged(LIGHT)))
    )
    assert across.shape[1] < LIGHT.shape[1]
    np.testing.assert_array_equal(down, exchanged(across))
    with pytest.raises(ValueError, match=r"have a picture of at least \d+ rows; got 12"):
        simulate_capture(LIGHT[:12], DOWN, *CAMERA, border="scene")
    with pytest.raises(ValueError, match=r"have a picture of at least \d+ columns; got 12"):
        simulate_capture(LIGHT[:, :12], ACROSS, *CAMERA, border="scene")


@pytest.mark.parametrize("decoder", [None, TotalVariationDecoder(num_iterations=20)])
def test_what_is_restored_of_it_is_too(decoder):
    """By a filter, and by a decoder that knows how rows go together."""
    captured = simulate_capture(LIGHT, ACROSS, *CAMERA, speed=450.0, key=jax.random.key(3))
    across = deconvolve(captured, ACROSS, *CAMERA, decoder=decoder)
    down = deconvolve(exchanged(captured), DOWN, *CAMERA, decoder=decoder)
    np.testing.assert_array_equal(down, exchanged(across))


@pytest.mark.parametrize("kind", ["photograph", "layers", "frames"])
def test_captured_and_restored_in_portions(kind):
    """Portions of rows are portions of columns, with the noise of each."""
    options = {"key": jax.random.key(3), "rows_at_once": 20}
    across = capture_and_restore(subject(kind, LIGHT), ACROSS, *CAMERA, **options)
    down = capture_and_restore(subject_down(kind, exchanged(LIGHT)), DOWN, *CAMERA, **options)
    for one, other in zip(down, across, strict=True):
        np.testing.assert_array_equal(one, exchanged(other))


@pytest.mark.parametrize("light", [LIGHT, LIGHT[..., 0]], ids=["colours", "grey"])
def test_a_burst_captured_and_restored_in_portions(light):
    """The same of its frames, each of which is turned by itself."""
    frames = tuple(TimedFrame(StillCamera(half_exposure=1e-3), time) for time in (-0.013, 0.011))
    burst = Exposures("stills", frames, 0.0, 31.0, 30.0)
    options = {"speed": 450.0, "key": jax.random.key(3), "rows_at_once": 20}
    down_light = light.swapaxes(0, 1)
    across = capture_and_restore(light, ACROSS, burst, **options)
    down = capture_and_restore(down_light, DOWN, burst, **options)
    assert down.captured.shape == (2, *down_light.shape)
    np.testing.assert_array_equal(down.captured, across.captured.swapaxes(1, 2))
    np.testing.assert_array_equal(down.restored, across.restored.swapaxes(0, 1))
    assert down.found.speed == across.found.speed
    with pytest.raises(ValueError, match=r"motion=...\)` must be of one exposure for footage"):
        capture_and_restore(light, ACROSS, burst, border="edge")
    with pytest.raises(ValueError, match=r"shutter=...\)` must be left to the exposures; got"):
        capture_and_restore(light, ACROSS, burst, CAMERA[1])


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_a_rolling_capture_in_portions_is_that_at_once(axis):
    """Its rows are exposed one after another from the first of all, not of each portion."""
    scene = Scene([450.0], **GIVEN, sensor=Sensor(axis=axis, readout=0.01))
    camera = StillCamera(half_exposure=2e-3), RectShutter()
    whole = simulate_capture(LIGHT, scene, *camera, speed=2450.0)
    parts = capture_and_restore(LIGHT, scene, *camera, speed=2450.0, rows_at_once=20)
    np.testing.assert_array_equal(parts.captured, whole)


@pytest.mark.slow
def test_a_photograph_at_every_speed():
    """Levels are the same, pictures turned; one that is too short is told so by its rows."""
    wide = example_picture().light[100:120, 100:500]
    across = restore_photograph(wide, ACROSS, *CAMERA, num_seeds=2)
    down = restore_photograph(exchanged(wide), DOWN, *CAMERA, num_seeds=2)
    for name in across._fields:
        one, other = getattr(down, name), getattr(across, name)
        is_picture = name in ("reference", "captured", "restored")
        np.testing.assert_array_equal(one, exchanged(other) if is_picture else other)
    tall, flat = (
        plot_photograph({"x": found}, [450.0], axis=axis)
        for found, axis in ((down, "columns"), (across, "rows"))
    )
    shapes = [[axes.images[0].get_array().shape[:2] for axes in f.axes[:5]] for f in (tall, flat)]
    assert shapes[0] == [shape[::-1] for shape in shapes[1]]
    with pytest.raises(ValueError, match=r"have at least \d+ rows; got 20"):
        restore_photograph(wide, DOWN, *CAMERA)


@pytest.mark.slow
def test_its_speed_is_found_alike():
    """The posterior is the same to the last digit."""
    wide = Picture(example_picture().light).luminance[:128, :512]
    speeds = np.linspace(-3000, 3000, 9)
    across, down = (
        Scene(speeds, **GIVEN, sensor=Sensor(axis=axis)) for axis in ("rows", "columns")
    )
    captured = simulate_capture(wide, across, *CAMERA, speed=1100.0, key=jax.random.key(3))
    found = estimate_speed(captured, across, *CAMERA)
    same = estimate_speed(exchanged(captured), down, *CAMERA)
    assert (same.speed, same.error, same.doubt) == (found.speed, found.error, found.doubt)
    np.testing.assert_array_equal(same.weights, found.weights)


def test_a_file_says_the_axis_and_its_photograph_is_read_along_it(tmp_path):
    """The spectrum is that of the columns; a scene as text keeps it."""
    write_picture(tmp_path / "tall.png", exchanged(LIGHT))
    text = """
        speeds = { list_px_per_s = [-700, 450] }
        light = { photon_rate_per_s = 1e5 }
        sensor = { read_noise_e = 4, axis = "columns" }
        picture = { path = "tall.png" }
    """
    (tmp_path / "scene.toml").write_text(text)
    scene = read_scene(tmp_path / "scene.toml")
    assert scene.sensor.axis == "columns"
    write_picture(tmp_path / "wide.png", LIGHT)
    (tmp_path / "scene.toml").write_text(text.replace("tall", "wide").replace("columns", "rows"))
    wide = read_scene(tmp_path / "scene.toml")
    np.testing.assert_array_equal(scene.picture.power_spectrum, wide.picture.power_spectrum)
    own = row_power_spectrum(Picture(exchanged(LIGHT))).power_spectrum
    assert not np.allclose(scene.picture.power_spectrum, own, rtol=0.1)
    (tmp_path / "again.toml").write_text(scene_text(scene))
    assert read_scene(tmp_path / "again.toml").sensor.axis == "columns"
    (tmp_path / "scene.toml").write_text(text.replace("columns", "diagonal"))
    with pytest.raises(ValueError, match=r"axis` must be 'rows' or 'columns'; got 'diagonal'"):
        read_scene(tmp_path / "scene.toml")
    with pytest.raises((ValueError, TypeError), match=r"'rows'.*'columns'"):
        Scene([1.0], **GIVEN, sensor=Sensor(axis="up"))


def test_targets_of_a_fit_move_along_it_too(tmp_path):
    """Their profile is the mean along the columns."""
    row = np.array([*[10.0] * 8, 40.0, 90.0, 30.0, *[10.0] * 8])
    levels = np.tile(row, (5, 1))
    across, down = TargetPicture(levels), TargetPicture(levels.T, axis="columns")
    np.testing.assert_array_equal(down.levels, across.levels)
    np.save(tmp_path / "point.npy", levels.T)
    (tmp_path / "fit.toml").write_text(
        '[sensor]\naxis = "columns"\n[[picture]]\npath = "point.npy"\n'
    )
    (found,) = read_measurements(tmp_path / "fit.toml").pictures
    np.testing.assert_array_equal(found.levels, across.levels)
    with pytest.raises(ValueError, match="must have at least 16 rows; got 5"):
        TargetPicture(levels, axis="columns")
    with pytest.raises((ValueError, TypeError), match=r"'rows'.*'columns'"):
        TargetPicture(levels, axis="up")


def test_a_detail_of_a_photograph_that_moves_down_is_that_across_turned():
    """Parts of one photograph that begin at several places show one detail, whichever way it moves.

    The panels of the detail are exchanged; the scene stands as the photograph does.
    """
    across = {"Hann": photograph(21), "still": photograph(17, columns=slice(4, 29))}
    down = {name: each.transposed("columns") for name, each in across.items()}
    pictures = [
        [axes.images[0].get_array() for axes in figure.axes if axes.images]
        for figure in (
            plot_photograph(across, [450.0], detail=(7, 9)),
            plot_photograph(down, [450.0], detail=(7, 9), axis="columns"),
        )
    ]
    for one, other in zip(*(each[:-1] for each in pictures), strict=True):
        np.testing.assert_allclose(other, np.swapaxes(one, 0, 1), rtol=1e-12)
    assert pictures[1][1].shape == (9, 7)


def lights_of(subject):
    """The arrays of a photograph with its matte, of layers with their corners, or of footage."""
    if isinstance(subject, Footage):
        return list(subject.frames)
    if isinstance(subject, Layers):
        corners = [np.array([[layer.left], [layer.top]]) for layer in subject.layers]
        return [*corners, *(layer.matte for layer in subject.layers)]
    return [subject.light, subject.matte]


@pytest.mark.parametrize("kind", ["picture", "layers", "frames"])
def test_a_subject_is_turned_by_the_axis_of_a_scene(kind):
    """One that moves along its rows stays as it is; of another all that it has is exchanged."""

    def made():
        matte = np.linspace(0.2, 0.9, 50 * 110).reshape(50, 110)
        return Picture(LIGHT, matte) if kind == "picture" else subject(kind, LIGHT)

    whole, along, down = (
        lights_of(each)
        for each in (made(), made().transposed("rows"), made().transposed("columns"))
    )
    for one, same, other in zip(whole, along, down, strict=True):
        np.testing.assert_array_equal(same, one)
        is_corner = one.shape == (2, 1)
        np.testing.assert_array_equal(other, one[::-1] if is_corner else exchanged(one))


def test_turning_twice_is_not_turning():
    """Of pictures of every shape, known or traced."""
    for shape in ((3, 5), (3, 5, 1), (2, 3, 5, 3)):
        light = np.arange(np.prod(shape), dtype=float).reshape(shape)
        once = transposed(light, "columns")
        assert once.shape[: once.ndim - (once.ndim > 2)][-2:] == (5, 3)
        np.testing.assert_array_equal(transposed(once, "columns"), light)
        traced = jax.jit(lambda x: transposed(x, "columns"))(jnp.asarray(light))
        np.testing.assert_array_equal(traced, once)
    assert transposed(light, "rows") is light
