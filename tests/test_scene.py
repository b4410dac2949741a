"""A scene made in Python is refused where it is made, by the argument that is wrong."""

from pathlib import Path

import numpy as np
import pytest

from mishutter import Limits, Scene

LIGHT = {"photon_rate": 1e5, "read_noise": 3.0}


@pytest.mark.parametrize(
    ("power", "message"),
    [
        (np.ones((2, 3)), r"must be one row of at least one value; got 'shape \(2, 3\)'"),
        (2.0, r"must be one row of at least one value; got 'shape \(\)'"),
        ([], r"must be one row of at least one value; got 'shape \(0,\)'"),
        ([0.3, -0.1], "must be at least 0; got"),
        ([0.0, 0.0, 0.0], "must hold some power where the deviation is not 0; got 0.0"),
    ],
)
def test_spectra_that_are_none(power, message):
    """A power spectrum is one row, and no picture with contrast is without power."""
    with pytest.raises(ValueError, match=message):
        Scene([0.0], **LIGHT, power_spectrum=power)


def test_a_picture_without_contrast_has_no_power():
    """What `row_power_spectrum` finds of one grey is a scene."""
    scene = Scene([0.0], **LIGHT, power_spectrum=np.zeros(7), deviation=0.0)
    assert not np.any(scene.power_spectrum)


@pytest.mark.parametrize(
    ("power", "cutoff", "first"), [(None, 9e-4, "0.000977"), (np.arange(8) > 5, 0.21, "0.345")]
)
def test_optics_that_pass_nothing_of_the_picture(power, cutoff, first):
    """A picture that the lens leaves nothing of is refused, not restored without error."""
    message = rf"pass some of the picture, whose power begins at {first} cycles/px; got {cutoff}"
    with pytest.raises(ValueError, match=message):
        Scene([0.0], **LIGHT, power_spectrum=power, cutoff_frequency=cutoff)
    Scene([0.0], **LIGHT, power_spectrum=power, cutoff_frequency=cutoff, deviation=0.0)
    Scene([0.0], **LIGHT, power_spectrum=power, cutoff_frequency=0.35)


@pytest.mark.parametrize("name", ["motion", "limits", "picture"])
def test_parts_that_are_something_else(name):
    """A part of the wrong kind is refused by name, also where annotations are not checked."""
    scene = Scene([0.0], **LIGHT)
    object.__setattr__(scene, name, 3)
    with pytest.raises(ValueError, match=rf"`Scene\({name}=...\)` must be .*; got 3"):
        scene.__check_init__()


def test_a_picture_may_be_a_path():
    """A path is kept as text, which a design file holds."""
    path = Path("some") / "photo.png"
    assert Scene([0.0], **LIGHT, picture=path).picture == str(path)


def test_a_scene_is_loaded_by_text_or_path(tmp_path):
    """A file is named by either, also where annotations are checked."""
    path = tmp_path / "scène 1.toml"
    path.write_text(
        "[speeds]\nlist_px_per_s = [7]\n[light]\nphoton_rate_per_s = 3e5\n"
        "[sensor]\nread_noise_e = 2\n"
    )
    for place in (path, str(path)):
        assert float(Scene.load(place).read_noise) == 2


def test_a_limit_is_one_number():
    """Two strokes are refused by name."""
    with pytest.raises(ValueError, match=r"`Limits\(max_stroke=...\)` must be a scalar; got"):
        Limits(max_stroke=np.array([1.0, 2.0]))
