"""A design on disk gives back the same numbers, or one line that says why not."""

import json
import re
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from support.bursts import SEQUENCE, a_burst_design
from support.designs import LIMITS, MOTION, SCENE

from mishutter import (
    BurstMode,
    ChippedShutter,
    Design,
    DesignLoss,
    ExpectedErrorLoss,
    FirstOrderDevice,
    FoundSpeedLoss,
    GaussianShutter,
    HannShutter,
    IdealDevice,
    KnownSpeedLoss,
    Limits,
    LinearMotion,
    Occlusion,
    OneExposure,
    ParabolicMotion,
    RectShutter,
    Scene,
    Sensor,
    SplineShutter,
    StillCamera,
    SwitchedDevice,
    Texture,
    Tolerances,
    TriangleShutter,
    TukeyShutter,
    WorstSpeedLoss,
    drive_table,
)
from mishutter._core.files import strict_json
from mishutter.design.design import Outcome, given_design, motion_to_dict
from mishutter.model.shutters.kinds import shutter_to_dict

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
    one = OneExposure(
        shutter=shutter,
        motion=MOTION,
        loss=0.25,
        history=np.array([0.5, 0.25]),
        outcome=Outcome.CONVERGED,
        certificate=1e-9,
        loss_name="ExpectedErrorLoss()",
        best_start_loss=0.5,
    )
    return Design(SCENE, one=one)


DEVICES = {
    "slots": IdealDevice(num_slots=14, transmission=0.8),
    "levels": IdealDevice(levels=5, leakage=0.02),
    "gradual": FirstOrderDevice(rise_time=2e-3, fall_time=3e-3, num_slots=20, delay=1e-3),
    "switched": SwitchedDevice(num_slots=40, min_open=2, min_closed=3),
}


def test_a_design_is_printed_on_a_screen(design):
    """The camera, its levels and its search, each in a line; in a list it is one line."""
    whole = design.with_one(history=np.linspace(0.5, 0.25, 300))
    lines = str(whole).splitlines()
    assert [line.split()[0] for line in lines[1:]] == (
        "expected shutter motion kernel loss search scene".split()
    )
    assert max(map(len, lines)) < 200
    assert lines[1].startswith(f"  expected  {float(design.metrics.expected_psnr):.2f} dB by one")
    assert f"over {design.metrics.dft_length} points" in lines[4]
    assert repr([whole]) == (
        "[Design(SplineShutter(parameters=5 from 0.2 to 1, symmetric=False, num_coefficients=5), "
        "ParabolicMotion(acceleration=220000.0, half_exposure=0.01, velocity=0.0), loss=0.25, "
        "converged=True)]"
    )
    table = drive_table(whole, num_steps=50)
    assert "\n" not in repr(table)
    assert len(repr(table)) < 500


@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_the_stroke_in_print_is_that_of_the_stage(design, pans):
    """From its lowest to its highest position, as in tables, with the pan that it makes itself."""
    limits = Limits(max_stroke=90.0, pans=pans)
    scene = eqx.tree_at(lambda s: s.limits, SCENE, limits)
    motion = ParabolicMotion(acceleration=2.1e5, half_exposure=0.0097, velocity=-2900.0)
    text = str(replace(design, scene=scene).with_one(motion=motion))
    time = np.linspace(-0.0097, 0.0097, 100_001)
    position = np.asarray(motion.position(time)) + 2900.0 * time * (pans == "camera")
    assert f", stroke {np.ptp(position):.4g} px" in text
    assert ("stroke 57.9 px" in text) == (pans == "stage")


def test_a_scene_is_printed_with_its_numbers():
    """Each part in a line, none that it lacks, and none as the type of an array."""
    device = IdealDevice(transmission=0.4)
    scene = eqx.tree_at(lambda s: s.device, SCENE, device, is_leaf=lambda part: part is None)
    lines = str(scene).splitlines()
    assert lines[0] == "Scene"
    assert "  speeds            5 from -2000 to 2000" in lines
    assert "  photon_rate       100000" in lines
    assert "  device            IdealDevice(transmission=0.4, leakage=0)" in lines
    assert not any("None" in line or "f64[" in line for line in lines)
    assert repr(SCENE) == "Scene(speeds=5 from -2000 to 2000, photon_rate=100000, read_noise=10)"


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)
def test_a_saved_design_has_the_parts_of_its_scene(design, device, tmp_path):
    """The device is of its own kind, and makes the same light of the same command.

    Tolerances and what hides what stand beside one device each, as they are saved apart.
    """
    errors = Tolerances(acceleration=0.02, delay=2e-4, num_accelerations=5, num_speeds=7)
    tolerances = errors if device is DEVICES["gradual"] else None
    layers = Occlusion(front_share=0.37, object_width=61.0, background="moving")
    occlusion = layers if device is DEVICES["slots"] else None
    parts = {"device": device, "tolerances": tolerances, "occlusion": occlusion}
    parts["burst"] = BurstMode(frames_per_s=99.0, max_frames=2)
    parts["sensor"] = Sensor(full_well=4e4)
    scene = replace(SCENE, **parts)
    light = scene.light(design.shutter, MOTION)
    replace(design, scene=scene).with_one(shutter=light).save(tmp_path / "design.json")
    read = Design.load(tmp_path / "design.json")
    for name, part in parts.items():
        assert eqx.tree_equal(getattr(read.scene, name), part), name
    assert eqx.tree_equal(read.shutter, light)


def test_a_saved_design_knows_how_its_photograph_is_read(design, tmp_path):
    """White and whether numbers are light come back; a file from before has the depth's white."""
    given = {"path": "a.tif", "white": 4095, "linear": True}
    scene = Scene([31.0, -420.0], photon_rate=2e5, read_noise=3.0, picture=Texture(**given))
    path = tmp_path / "design.json"
    replace(design, scene=scene).save(path)
    read = Design.load(path).scene.picture
    assert {name: getattr(read, name) for name in given} == given
    document = json.loads(path.read_text("utf-8"))
    del document["scene"]["picture"]["white"], document["scene"]["picture"]["linear"]
    path.write_text(json.dumps(document))
    read = Design.load(path).scene.picture
    assert (read.white, read.linear) == (None, False)


@pytest.mark.slow
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
    design.with_one(shutter=closed).save(tmp_path / "design.json")

    def refuse(token):
        raise AssertionError(token)

    text = (tmp_path / "design.json").read_text("utf-8")
    assert json.loads(text, parse_constant=refuse)["metrics"]["condition_number"] == "Infinity"
    assert np.isposinf(Design.load(tmp_path / "design.json").metrics.condition_number)


def test_the_profile_is_a_table_with_units(design, tmp_path):
    """CSV: names, units, then time in ms over the whole exposure."""
    design.write_profile(tmp_path / "profile.csv")
    lines = (tmp_path / "profile.csv").read_text("utf-8").splitlines()
    assert lines[:2] == ["time,tau,transmittance", "ms,1,1"]
    rows = np.array([[float(x) for x in line.split(",")] for line in lines[2:]])
    assert np.isclose(rows[0, 0], -10)
    assert np.isclose(rows[-1, 0], 10)
    assert np.all((rows[:, 2] >= 0) & (rows[:, 2] <= 1))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda data: data | {"format": 99}, "be of design format 2; got"),
        (lambda data: [1, 2], "be a design saved by mishutter; got"),
        (lambda data: data | {"shutter": {"kind": "Iris"}}, "be one of"),
    ],
)
def test_another_file_is_refused(design, tmp_path, change, text):
    """A file of another version, kind or shape: one line."""
    path = tmp_path / "design.json"
    path.write_text(json.dumps(change(design.to_dict())))
    with pytest.raises(ValueError, match=text):
        Design.load(path)


MISTAKES = {
    "no-motion": (("motion",), None, "`motion` must be a table; got None"),
    "other-motion": (
        ("motion", "kind"),
        "Foo",
        "'ParabolicMotion' or 'FreeMotion'",
    ),
    "no-exposure": (("motion", "half_exposure"), None, "must be a number; got None"),
    "exposure-before-it-began": (("motion", "half_exposure"), -1.0, "must be above 0 s; got -1"),
    "profile-as-text": (
        ("shutter", "parameters"),
        "abc",
        "must be a number or a list of numbers; got",
    ),
    "profile-of-nothing": (("shutter", "parameters"), None, "be given for a SplineShutter; got"),
    "profile-too-short": (("shutter", "parameters"), [1, 0.5], "at least 4 coefficients; got"),
    "symmetry-as-text": (("shutter", "symmetric"), "no", "must be true or false; got 'no'"),
    "width-of-a-spline": (("shutter", "sigma"), 0.3, "must be left out of a SplineShutter; got"),
    "ragged-speeds": (("scene", "speeds"), [[1], [2, 3]], "`scene.speeds[0]` must be a number"),
    "spectrum-as-text": (("scene", "picture", "power_spectrum"), "x", "must be a list; got 'x'"),
    "two-strokes": (("scene", "limits", "max_stroke"), [1, 2], "must be a number; got [1, 2]"),
    "picture-as-number": (
        ("scene", "picture", "path"),
        5,
        "`scene.picture.path` must be text; got 5",
    ),
    "light-by-another-name": (("scene", "photon"), 5, "perhaps `scene.photon_rate`; got 'photon'"),
    "loss-as-text": (("loss",), "abc", "`loss` must be a number; got 'abc'"),
    "history-as-text": (("history",), "x", "`history` must be a list; got 'x'"),
}
"""Slug to the key that is changed, its value, and the error."""


@pytest.mark.parametrize("slug", MISTAKES)
def test_mistakes_in_a_design_are_named(design, tmp_path, slug):
    """Each is refused in one line that names the file and the key."""
    (*tables, key), value, message = MISTAKES[slug]
    data = json.loads(json.dumps(design.to_dict()))
    table = data
    for name in tables:
        table = table[name]
    table[key] = value
    path = tmp_path / "design.json"
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        Design.load(path)
    assert str(caught.value).startswith(f"{path}: `")
    assert "\n" not in str(caught.value)


PANNING = MOTION.panned(-0.1 * float(MOTION.speed_gain))
MOTIONS = [
    MOTION,
    PANNING,
    LinearMotion(half_exposure=0.0021, velocity=1 / 3),
    StillCamera(half_exposure=0.0021),
]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_every_shutter_on_every_motion_is_loaded(design, tmp_path, slug, motion):
    """All that metrics are measured of comes back to the last bit."""
    parts = {"shutter": shutter_to_dict(SHUTTERS[slug]), "motion": motion_to_dict(motion)}
    path = tmp_path / "design.json"
    path.write_text(strict_json(design.to_dict() | parts))
    loaded = Design.load(path)
    saved = (SHUTTERS[slug], motion, SCENE)
    found = (loaded.shutter, loaded.motion, loaded.scene.without_metadata())
    assert jax.tree.structure(saved) == jax.tree.structure(found)
    assert jax.tree.all(jax.tree.map(np.array_equal, saved, found))


def test_numbers_that_json_has_no_token_for_come_back(design, tmp_path):
    """An infinite loss, and one that is none."""
    other, path = design.with_one(best_start_loss=np.inf, certificate=np.nan), tmp_path / "a.json"
    other.save(path)
    loaded = Design.load(path)
    assert np.isposinf(loaded.best_start_loss)
    assert np.isnan(loaded.certificate)


def test_a_design_of_an_earlier_version_is_loaded(design, tmp_path):
    """Without a velocity it has none, and its largest pan is the top speed, a former key none."""
    data = json.loads(strict_json(design.to_dict()))
    assert data["motion"].pop("velocity") == 0
    del data["scene"]["limits"]["max_pan"]
    data["scene"]["limits"]["free_paths"] = False
    (tmp_path / "design.json").write_text(json.dumps(data))
    loaded = Design.load(tmp_path / "design.json")
    assert float(loaded.motion.velocity) == 0
    assert float(loaded.scene.limits.max_pan) == float(SCENE.limits.max_top_speed)
    assert jax.tree.all(jax.tree.map(np.array_equal, design.metrics, loaded.metrics))


def test_a_truncated_file_is_refused(tmp_path):
    """Half a JSON document is named as such."""
    path = tmp_path / "design.json"
    path.write_text('{"format": 2, ')
    with pytest.raises(ValueError, match="be a JSON file; got"):
        Design.load(path)


def test_nothing_is_left_behind_where_writing_fails(design, tmp_path):
    """A folder in the file's place: an OSError and no debris."""
    (tmp_path / "design.json").mkdir()
    with pytest.raises(OSError, match="directory"):
        design.save(tmp_path / "design.json")
    assert [file.name for file in tmp_path.iterdir()] == ["design.json"]


LEVELS = {
    "one filter": (ExpectedErrorLoss(), {}, "expected_psnr", "by one linear filter for all speeds"),
    "known": (KnownSpeedLoss(), {}, "known_speed_psnr", "by a linear filter that knows the speed"),
    "found": (
        FoundSpeedLoss(),
        {},
        "found_speed_psnr",
        "by a decoder that finds the speed in the picture",
    ),
    "worst": (
        WorstSpeedLoss(),
        {},
        "worst_speed_psnr",
        "by one linear filter for all speeds, at the worst speed",
    ),
    "tolerances": (
        ExpectedErrorLoss(),
        {"tolerances": Tolerances(acceleration=0.04, delay=3e-4)},
        "toleranced_psnr",
        "by one linear filter for all speeds, within the tolerances",
    ),
    "the scene's": (
        DesignLoss(),
        {"decoder_speed": "found"},
        "found_speed_psnr",
        "by a decoder that finds the speed in the picture",
    ),
}


@pytest.mark.parametrize("slug", LEVELS)
def test_the_level_that_was_optimised_comes_first(slug, tmp_path):
    """In print and in the file, by the decoder that the loss, or else the scene, designs for."""
    loss, others, metric, words = LEVELS[slug]
    scene = Scene([-900.0, 310.0, 900.0], photon_rate=4e4, read_noise=5.0, limits=LIMITS, **others)
    motion = ParabolicMotion(acceleration=6e4, half_exposure=0.011)
    design = given_design(scene, motion, HannShutter(), "").with_one(loss_name=repr(loss))
    level = float(getattr(design.metrics, metric))
    assert str(design).splitlines()[1].split(None, 1)[1].startswith(f"{level:.2f} dB {words}")
    design.save(tmp_path / "design.json")
    saved = json.loads((tmp_path / "design.json").read_text("utf-8"))
    assert list(saved.items())[:2] == [("level_db", level), ("level_of", words)]
    assert Design.load(tmp_path / "design.json").levels == design.levels


def test_the_end_of_a_search_comes_back_and_is_compared(design, tmp_path):
    """With its notes; a file that ends otherwise is refused by what it says."""
    path = tmp_path / "design.json"
    for outcome in Outcome:
        design.with_one(outcome=outcome, notes=("It was windy.", "Nobody came.")).save(path)
        read = Design.load(path)
        assert read.outcome is outcome
        assert read.converged == (outcome is Outcome.CONVERGED)
        assert read.ending == f"{outcome} It was windy. Nobody came."
    document = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps(document | {"outcome": "It was windy."}))
    with pytest.raises(ValueError, match="`outcome` must be the end of a search in a"):
        Design.load(path)


def test_frames_of_a_burst_travel_with_the_design(tmp_path):
    """Each with its motion, time and place; their level is the file's first number."""
    design = a_burst_design()
    design.save(tmp_path / "design.json")
    read = Design.load(tmp_path / "design.json")
    assert strict_json(read.to_dict()) == strict_json(design.to_dict())
    assert repr(read.sequence) == repr(SEQUENCE)
    for one, other in zip(read.sequence.frames, SEQUENCE.frames, strict=True):
        assert (one.time, one.position) == (other.time, other.position)
        elapsed = np.array([-0.7, 0.3]) * one.exposure / 2
        np.testing.assert_allclose(one.motion.position(elapsed), other.motion.position(elapsed))
    saved = json.loads((tmp_path / "design.json").read_text(encoding="utf-8"))
    assert (saved["level_db"], saved["level_of"]) == (
        31.25,
        "by a decoder that registers the frames",
    )
    assert "1 of 4.2 ms at rest and 1 of 13.6 ms: 31.25 dB" in str(read)
    assert replace(read, sequence=None).to_dict()["level_db"] != 31.25


def test_a_file_with_a_frame_that_is_none_is_refused(tmp_path):
    """The line names the file and the key."""
    whole = a_burst_design().to_dict()
    for frames, key in (([], "frames"), ([{"time_s": 0.0}], "position_px")):
        saved = whole | {"sequence": whole["sequence"] | {"frames": frames}}
        (tmp_path / "cut.json").write_text(strict_json(saved), encoding="utf-8")
        with pytest.raises(ValueError, match=rf"cut\.json.*{key}"):
            Design.load(tmp_path / "cut.json")
