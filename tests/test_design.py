"""A design on disk gives back the same numbers, or one line that says why not."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
from helpers_design import MOTION, SCENE

from mishutter import (
    ChippedShutter,
    Design,
    GaussianShutter,
    HannShutter,
    RectShutter,
    SplineShutter,
    StillCamera,
    TriangleShutter,
    TukeyShutter,
)
from mishutter.design import motion_to_dict, shutter_from_dict, shutter_to_dict

SHUTTERS = {
    "rect": RectShutter(),
    "hann": HannShutter(),
    "triangle": TriangleShutter(),
    "gaussian": GaussianShutter(0.31),
    "tukey": TukeyShutter(0.61),
    "chips": ChippedShutter([0.1, 0.9, 1.0, 0.3]),
    "spline": SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4]),
    "symmetric": SplineShutter([0.2, 0.7, 0.9], symmetric=True, num_coefficients=5),
}


@pytest.fixture(scope="module")
def design():
    shutter = SHUTTERS["spline"]
    return Design(
        shutter=shutter,
        motion=MOTION,
        scene=SCENE,
        loss=0.25,
        history=np.array([0.5, 0.25]),
        converged=True,
        outcome="The search converged.",
        certificate=1e-9,
        loss_name="ExpectedErrorLoss()",
        best_start_loss=0.5,
    )


def test_a_saved_design_gives_back_its_metrics(design, tmp_path):
    """One JSON file, loaded to bit-identical metrics, shutter and scene."""
    path = tmp_path / "design.json"
    design.save(path)
    loaded = Design.load(path)
    same = jax.tree.map(lambda x, y: bool(x == y), design.metrics, loaded.metrics)
    assert jax.tree.all(same)
    assert loaded.to_dict() == design.to_dict()
    assert [file.name for file in tmp_path.iterdir()] == ["design.json"]


def test_an_infinite_condition_number_is_strict_json(design, tmp_path):
    """JSON has no token for infinity: a closed shutter's design still reads anywhere."""
    closed = ChippedShutter([0.0, 0.0])
    replace(design, shutter=closed).save(tmp_path / "design.json")

    def refuse(token):
        raise AssertionError(token)

    text = (tmp_path / "design.json").read_text()
    assert json.loads(text, parse_constant=refuse)["metrics"]["condition_number"] == "Infinity"
    assert np.isposinf(Design.load(tmp_path / "design.json").metrics.condition_number)


@pytest.mark.parametrize("slug", SHUTTERS)
def test_every_kind_of_shutter_survives(slug):
    """The same transmittance after a round trip through JSON."""
    data = json.loads(json.dumps(shutter_to_dict(SHUTTERS[slug])))
    tau = np.linspace(-1.1, 1.1, 45)
    restored = shutter_from_dict(data)
    assert np.array_equal(restored.transmittance(tau), SHUTTERS[slug].transmittance(tau))


def test_a_still_camera_is_written_as_one():
    """The motion's kind is kept."""
    assert motion_to_dict(StillCamera(half_exposure=0.002))["kind"] == "StillCamera"


def test_the_profile_is_a_table_with_units(design, tmp_path):
    """CSV: names, units, then time in ms over the whole exposure."""
    design.write_profile(tmp_path / "profile.csv")
    lines = (tmp_path / "profile.csv").read_text().splitlines()
    assert lines[:2] == ["time,tau,transmittance", "ms,1,1"]
    rows = np.array([[float(x) for x in line.split(",")] for line in lines[2:]])
    assert np.isclose(rows[0, 0], -10)
    assert np.isclose(rows[-1, 0], 10)
    assert np.all((rows[:, 2] >= 0) & (rows[:, 2] <= 1))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda data: data | {"format": 99}, "be of design format 1; got"),
        (lambda data: [1, 2], "be a design saved by mishutter; got"),
        (lambda data: {k: v for k, v in data.items() if k != "motion"}, "be a complete design"),
        (lambda data: data | {"shutter": {"kind": "Iris"}}, "be one of"),
    ],
)
def test_another_file_is_refused(design, tmp_path, change, text):
    """A file of another version, kind or shape: one line."""
    path = tmp_path / "design.json"
    path.write_text(json.dumps(change(design.to_dict())))
    with pytest.raises(ValueError, match=text):
        Design.load(path)


def test_a_truncated_file_is_refused(tmp_path):
    """Half a JSON document is named as such."""
    path = tmp_path / "design.json"
    path.write_text('{"format": 1, ')
    with pytest.raises(ValueError, match="be a JSON file; got"):
        Design.load(path)


def test_nothing_is_left_behind_where_writing_fails(design, tmp_path):
    """A folder in the file's place: an OSError and no debris."""
    (tmp_path / "design.json").mkdir()
    with pytest.raises(OSError, match="directory"):
        design.save(tmp_path / "design.json")
    assert [file.name for file in tmp_path.iterdir()] == ["design.json"]
