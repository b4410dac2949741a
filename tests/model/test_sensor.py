"""The sensor: its width, in Python and in files."""

import numpy as np
import pytest

from mishutter import Scene, Sensor
from mishutter.model import scene_text

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
    assert scene.bare().sensor.width is None
    assert "width=1944" in repr(scene.sensor)
    assert Sensor().width is None
