"""Laws of velocities in any direction, and the scenes that have them."""

import numpy as np
import pytest

from mishutter import (
    EvenVelocities,
    ListedVelocities,
    PlaneFrames,
    RectShutter,
    RingOfVelocities,
    Scene,
    best_sequence,
    ceiling,
    evaluate,
    exposures_psnr,
    optimise,
)
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.model.velocities import AbstractVelocities

LIGHT = {"photon_rate": 3e4, "read_noise": 9.0}
ANGLES = np.array([0.3, 1.1, 2.6])
LAWS = {
    "disc": (EvenVelocities(2700.0), "{ max_px_per_s = 2700.0 }"),
    "ellipse": (
        EvenVelocities(2700.0, 400.0, angle=np.radians(25.0)),
        "{ along_px_per_s = 2700.0, across_px_per_s = 400.0, angle_deg = 25.0 }",
    ),
    "disc about a mean": (
        EvenVelocities(300.0, mean=[2000.0, -40.0]),
        "{ max_px_per_s = 300.0, mean_px_per_s = [2000, -40] }",
    ),
    "ellipse about a mean": (
        EvenVelocities(2700.0, 400.0, angle=np.radians(25.0), mean=[10.0, 700.0]),
        "{ along_px_per_s = 2700.0, across_px_per_s = 400.0, angle_deg = 25.0, "
        "mean_px_per_s = [10, 700] }",
    ),
    "ring": (RingOfVelocities(1300.0), "{ speed_px_per_s = 1300.0 }"),
    "list": (
        ListedVelocities([[900.0, -300.0], [20.0, 1700.0], [-50.0, 0.0]], [3.0, 1.0, 0.0]),
        "{ list_px_per_s = [[900, -300], [20, 1700], [-50, 0]], weights = [0.75, 0.25, 0.0] }",
    ),
}


def drawn(law: AbstractVelocities, count: int = 200_000) -> np.ndarray:
    """Velocities of a law, drawn at random; px/s, `(count, 2)`."""
    rng = np.random.default_rng(5)
    turn, share = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(size=count))
    unit = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    if isinstance(law, RingOfVelocities):
        return float(law.speed) * unit
    if isinstance(law, ListedVelocities):
        return np.asarray(law.velocities)[rng.choice(3, count, p=np.asarray(law.weights))]
    ellipse = share[:, None] * unit * [float(law.along), float(law.across)]
    c, s = np.cos(float(law.angle)), np.sin(float(law.angle))
    return ellipse @ np.array([[c, s], [-s, c]]) + np.asarray(law.mean)


@pytest.mark.parametrize("slug", LAWS)
def test_components_have_the_moments_of_velocities_that_are_drawn(slug):
    """Second and fourth moments along three directions, and the greatest component."""
    law, _ = LAWS[slug]
    parts = law.components(ANGLES, 12)
    units = np.stack([np.cos(ANGLES), np.sin(ANGLES)])
    along = drawn(law) @ units
    for power in (1, 2, 4):
        moments = np.broadcast_to((parts.weights * parts.speeds**power).sum(-1), ANGLES.shape)
        scale = (np.abs(along) ** power).mean(0)
        np.testing.assert_allclose(moments, (along**power).mean(0), atol=0.02 * scale.max())
    np.testing.assert_allclose(law.greatest(ANGLES), np.abs(along).max(0), rtol=0.01)


@pytest.mark.parametrize("slug", ["disc", "ring"])
def test_cells_hold_the_second_moment(slug):
    """Cells cover the components from -1 to 1, and their masses sum to 1."""
    law, _ = LAWS[slug]
    cells = law.cells(200)
    assert cells.width.sum() == pytest.approx(2)
    assert cells.mass.sum() == pytest.approx(1)
    middles = np.cumsum(cells.width) - cells.width / 2 - 1
    assert cells.mass @ middles**2 == pytest.approx({"disc": 0.25, "ring": 0.5}[slug], abs=1e-3)


BASE = """
[light]
photon_rate_per_s = 3e4
[sensor]
read_noise_e = 9
pixel_pitch_um = 5
[view]
magnification = 40
[limits]
max_half_exposure_ms = 20
"""


def loaded(tmp_path, law: str, more: str = BASE) -> Scene:
    path = tmp_path / "scene.toml"
    path.write_text(f"[speeds]\nany_direction = {law}\n{more}")
    return Scene.load(path)


@pytest.mark.parametrize("slug", LAWS)
def test_a_file_holds_each_law(slug, tmp_path):
    """It is read, saved and read again; the greatest speed is that of the law."""
    law, text = LAWS[slug]
    scene = loaded(tmp_path, text)
    scene.save(tmp_path / "again.toml")
    for read in (scene, Scene.load(tmp_path / "again.toml")):
        assert type(read.velocities) is type(law)
        for own, other in zip(vars(read.velocities).values(), vars(law).values(), strict=True):
            np.testing.assert_allclose(own, other, rtol=1e-12)
        assert float(read.max_speed) == pytest.approx(law.fastest)


def test_units_are_those_of_things(tmp_path):
    """40 um/s at a magnification of 40 and 5 um a pixel is 320 px/s."""
    law = loaded(tmp_path, "{ along_um_per_s = 40, across_um_per_s = 3 }").velocities
    assert float(law.along) == pytest.approx(320)
    assert float(law.across) == pytest.approx(24)


FILE = "[speeds] any_direction"
BAD_FILES = {
    "{}": f"`{FILE}` must hold one of max_px_per_s, along_px_per_s, speed_px_per_s and "
    "list_px_per_s; got none of them.",
    "{ max_px_per_s = 3, speed_px_per_s = 2 }": "got max and speed.",
    "{ max_px_per_s = 3, across_px_per_s = 2 }": f"`{FILE}.across` must go with along_px_per_s; "
    "got max.",
    "{ along_px_per_s = 3 }": f"`{FILE}.across_px_per_s` must be given; got nothing.",
    "{ along_px_per_s = 3, across_px_per_s = 5 }": "must be at most along_px_per_s = 3; got 5.0.",
    "{ along_px_per_s = 3, across_um_per_s = 2 }": "got along_px_per_s and across_um_per_s.",
    "{ list_px_per_s = [[1, 2, 3]] }": "got [1, 2, 3].",
    "{ list_px_per_s = [[1, 2]], weights = [1.0, 0.5] }": "must be 1, one a velocity; got 2.",
    "{ speed_m_per_s = 900 }": f"`{FILE}` must be at most 1e+07 px/s; got ",
}


@pytest.mark.parametrize("law", BAD_FILES)
def test_a_law_that_is_wrong_gets_one_line(law, tmp_path):
    """The line names the key, what must hold and what came."""
    with pytest.raises(ValueError, match=r"scene.toml: ") as caught:
        loaded(tmp_path, law)
    assert BAD_FILES[law] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("section", ["motion", "tolerances"])
def test_a_file_leaves_out_what_is_known_along_one_axis(section, tmp_path):
    """Such a section is named in the error."""
    keys = {"motion": "half_exposure_ms = 3\nsag_px = 4"}
    more = f"{BASE}[{section}]\n{keys.get(section, '')}\n"
    with pytest.raises(
        ValueError, match=rf"`\[{section}\]` must stand beside speeds along one axis"
    ):
        loaded(tmp_path, "{ max_px_per_s = 270 }", more)


BAD_LAWS = {
    "`EvenVelocities(along=...)` must be above 0": lambda: EvenVelocities(0.0),
    "`EvenVelocities(across=...)` must be at most along = 3 px/s; got 4.0": lambda: EvenVelocities(
        3.0, 4.0
    ),
    "`RingOfVelocities(speed=...)` must be above 0": lambda: RingOfVelocities(-2.0),
    "`ListedVelocities(velocities=...)` must be rows of two components": lambda: ListedVelocities(
        np.array([1.0, 2.0])
    ),
    "`ListedVelocities(velocities=...)` must hold one above 0 px/s": lambda: ListedVelocities(
        [[0.0, 0.0]]
    ),
    "`ListedVelocities(weights=...)` must hold one above 0": lambda: ListedVelocities(
        [[1.0, 2.0]], [0.0]
    ),
    "`Scene.any_direction(motion=...)` must be left to one axis": lambda: Scene.any_direction(
        2700.0, motion=3, **LIGHT
    ),
}


@pytest.mark.parametrize("text", BAD_LAWS)
def test_a_law_is_checked(text):
    """Each number that is out of its range is named."""
    with pytest.raises(ValueError, match="must") as caught:
        BAD_LAWS[text]()
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "user",
    [
        ceiling,
        optimise,
        lambda scene: evaluate(scene, scene.motion, RectShutter()),
        best_sequence,
    ],
)
def test_what_computes_along_one_axis_refuses_a_scene_of_any_direction(user):
    """It is never taken for one axis without a word."""
    scene = Scene.any_direction(2700.0, **LIGHT)
    line = "`scene` must move along one axis here; .*; got up to 2,700 px/s in any direction"
    with pytest.raises(ValueError, match=line):
        user(scene)


def test_velocities_about_a_mean_are_those_at_rest_for_a_sensor_that_moves_along():
    """Components, levels and ceilings of an ellipse, on a pan at its mean velocity."""
    mean = np.array([900.0, -350.0])
    away, at_rest = (
        EvenVelocities(400.0, 250.0, angle=0.4, mean=mean),
        EvenVelocities(400.0, 250.0, angle=0.4),
    )
    angles = np.array([0.2, 1.9])
    apart = away.components(angles, 8).speeds - at_rest.components(angles, 8).speeds
    wanted = np.cos(angles) * mean[0] + np.sin(angles) * mean[1]
    np.testing.assert_allclose(apart, np.tile(wanted[:, None], 8), rtol=1e-12)
    np.testing.assert_allclose(away.stand_ins()[0] - at_rest.stand_ins()[0], np.tile(mean, (24, 1)))
    assert away.within(mean[None], 0.0)[0]
    assert not away.within(np.zeros((1, 2)), 0.0)[0]
    assert away.fastest == pytest.approx(
        np.max(away.greatest(np.linspace(0, np.pi, 9999))), rel=1e-6
    )
    path = {"times": np.array([0.0]), "exposures": np.array([0.02]), "durations": np.array([0.02])}
    still, panned = (
        PlaneFrames(**path, velocities=np.tile(v[:, None], 2)) for v in (0 * mean, mean)
    )
    scenes = [Scene.any_direction(law, photon_rate=3e4, read_noise=9.0) for law in (at_rest, away)]
    levels = [float(exposures_psnr(x, y)) for x, y in zip(scenes, (still, panned), strict=True)]
    assert levels[1] == pytest.approx(levels[0], rel=1e-9)
    ceilings = [exposures_ceiling(scene, np.array([0.02, 0.01])) for scene in scenes]
    assert ceilings[1] == pytest.approx(ceilings[0], rel=1e-12)


@pytest.mark.parametrize("mean", [[1.0], [np.nan, 0.0], 3.0])
def test_a_mean_velocity_is_two_finite_numbers(mean):
    """An error names the argument."""
    with pytest.raises(ValueError, match=r"EvenVelocities\(mean=...\)"):
        EvenVelocities(300.0, mean=mean)


def test_the_speed_of_a_disc_may_have_its_name():
    """`max_speed` is the number of the disc, in place of the law and not beside it."""
    named = Scene.any_direction(max_speed=2700.0, **LIGHT)
    assert repr(named) == repr(Scene.any_direction(2700.0, **LIGHT))
    with pytest.raises(ValueError, match=r"any_direction\(velocities=...\)` must be left to max"):
        Scene.any_direction(2700.0, max_speed=2700.0, **LIGHT)
    with pytest.raises(ValueError, match=r"any_direction\(velocities=...\)` must be given, or"):
        Scene.any_direction(**LIGHT)
