"""The sensor: its width, in Python and in files, its noise, and when its pixels are full."""

import re
from functools import partial

import numpy as np
import pytest

from mishutter import BurstMode, Scene, Sensor
from mishutter.model.scene import scene_text
from mishutter.model.sensor import filling_half_exposure, noise_power

LIGHT = {"photon_rate": 4e4, "read_noise": 3.0}


@pytest.mark.parametrize("width", [0.0, -640.0, np.nan, np.inf, np.array([640.0, 480.0])])
def test_a_width_that_is_none_is_refused_by_name(width):
    """One line says the argument, which is one number above 0."""
    with pytest.raises(ValueError, match=r"^`Sensor\(width=...\)` must be .*; got [^\n]*$"):
        Sensor(width=width)


@pytest.mark.parametrize("width", ["0", "-640", "nan", "inf", "2e6", '"wide"'])
def test_a_width_that_a_file_cannot_have_is_refused_by_its_key(width, tmp_path):
    """One line says the section and the key."""
    path = tmp_path / "scene.toml"
    text = scene_text(Scene([310.0], **LIGHT, sensor=Sensor(width=640)))
    assert "width_px = 640.0" in text
    path.write_text(text.replace("640.0", width))
    with pytest.raises(ValueError, match=r"^[^\n]*`\[sensor\] width_px` must [^\n]*$"):
        Scene.load(path)


def test_the_width_of_a_sensor_is_that_along_the_motion():
    """Pictures that are turned for it keep it; no integral of a design sees it."""
    scene = Scene([310.0], **LIGHT, sensor=Sensor(full_well=900, axis="columns", width=1944))
    assert float(scene.along_rows().sensor.width) == 1944
    assert scene.without_metadata().sensor.width is None
    assert "width=1944" in repr(scene.sensor)
    assert Sensor().width is None


def test_rows_are_exposed_one_after_another():
    """The middle of the rows is at 0, and a sensor that reads upwards begins with the last."""
    down = Sensor(readout=0.03)
    np.testing.assert_allclose(down.row_delays(4), [-0.015, -0.005, 0.005, 0.015], rtol=1e-6)
    up = Sensor(readout=0.03, rows_read="up").row_delays(5)
    np.testing.assert_allclose(up, [0.015, 0.0075, 0, -0.0075, -0.015], rtol=1e-6)
    assert not Sensor().is_rolling
    assert not np.any(Sensor().row_delays(3))
    assert down.row_delays(1) == 0


@pytest.mark.parametrize(
    ("keys", "wanted"),
    [
        ("readout_ms = 12.5", (12.5, "down")),
        ('line_time_us = 25\nrows = 401\nrows_read = "up"', (10.0, "up")),
        ("readout_ms = 0", (0.0, "down")),
        ("", (0.0, "down")),
        ("line_time_us = 25", "`[sensor] rows` must be given where line_time_us is"),
        ("rows = 401", "`[sensor] rows` must stand beside line_time_us"),
        ("line_time_us = 5\nreadout_ms = 2\nrows = 9", "must not stand beside readout_ms"),
        ("readout_ms = -1", "`[sensor] readout_ms` must be at least 0; got -1"),
        ('rows_read = "left"', "`[sensor] rows_read` must be 'down' or 'up'"),
        ("readout_ms = 20.5", "`[sensor] readout_ms` must be at most the 20 ms from frame to f"),
        ("rolling_shutter = 9", "perhaps `[sensor] readout_ms`"),
    ],
)
def test_the_keys_of_a_rolling_sensor(keys, wanted, tmp_path):
    """A readout is that of all rows, or of each row and their number, and is written back."""
    path, text = tmp_path / "scene.toml", scene_text(Scene([310.0], **LIGHT))
    burst = "[burst]\nframes_per_s = 50"
    path.write_text(text.replace("[sensor]", f"{burst}\n\n[sensor]\n{keys}"))
    if isinstance(wanted, str):
        with pytest.raises(ValueError, match=re.escape(wanted)):
            Scene.load(path)
        return
    sensor = Scene.load(path).sensor
    assert sensor.readout_time * 1e3 == pytest.approx(wanted[0], rel=1e-6)
    assert sensor.rows_read == wanted[1]
    Scene.load(path).save(tmp_path / "again.toml")
    again = Scene.load(tmp_path / "again.toml").sensor
    assert (again.readout_time, again.rows_read) == (sensor.readout_time, sensor.rows_read)


def test_a_readout_that_is_none_is_refused():
    """One line says the argument."""
    with pytest.raises(ValueError, match=r"readout=...\)` must be at least 0"):
        Sensor(readout=-0.1)


def test_noise_is_that_of_equation_four_in_every_unit():
    r"""$\eta f p + \sigma^2$ electrons squared, over the square of the unit."""
    wanted = 0.43 * 0.27 * 8.1e3 + 5.5**2
    numbers = 0.43, 0.27, 8.1e3, 5.5
    assert noise_power(*numbers) == pytest.approx(wanted, rel=1e-14)
    assert noise_power(*numbers, unit=8.1e3) == pytest.approx(wanted / 8.1e3**2, rel=1e-14)


def test_white_fills_a_pixel_when_its_electrons_do():
    """After $2T$ at half the transmittance half the electrons are there; without light, never."""
    half = filling_half_exposure(900.0, np.array([2e4, 0.0]), 0.5)
    assert half[0] * 2 * 2e4 * 0.5 == pytest.approx(900.0, rel=1e-14)
    assert np.isinf(half[1])


@pytest.mark.parametrize("rate", [7, 24, 30, 60])
def test_rows_are_read_before_the_next_frame_is(rate):
    """As long as from frame to frame in whatever precision; more is refused in one line."""
    make = partial(Scene, [310.0], burst=BurstMode(frames_per_s=rate), **LIGHT)
    assert make(sensor=Sensor(readout=np.float32(1 / rate))).sensor.is_rolling
    line = (
        rf"`Sensor\(readout=...\)` must be at most the {1e3 / rate:g} ms from frame to frame; got"
    )
    with pytest.raises(ValueError, match=line):
        make(sensor=Sensor(readout=1.001 / rate))
