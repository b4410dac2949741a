"""Searches whose path is free: within the limits, and never worse than a parabola."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import (
    FreeMotion,
    HannShutter,
    Limits,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    Tolerances,
    TukeyShutter,
    compare,
    evaluate,
    optimise,
)
from mishutter.evaluation.speed_knowledge import ExpectedErrorLoss
from mishutter.model.stages import stage_path, stage_use

# The space of a search, whose ends and sizes no design holds.
from mishutter.search.space import beyond_limits, design_space

NUMBERS = {
    "max_stroke": 45.0,
    "max_top_speed": 1.5e4,
    "min_half_exposure": 5e-4,
    "max_half_exposure": 0.03,
}
STAGE = {"max_travel": 64.0, "max_acceleration": 1.5e6}
NAMES = ("path", "half_exposure", "acceleration")
NUM_PIECES = 6


def scene(low=-4500.0, high=4500.0, num_speeds=5, **stage):
    """A dim scene; one that mirrors itself by default."""
    limits = Limits(**NUMBERS, **stage)
    speeds = np.linspace(low, high, num_speeds)
    return Scene(speeds, photon_rate=1e5, read_noise=8.0, limits=limits)


PARABOLA = ParabolicMotion(acceleration=1.1e5, half_exposure=0.012)
PATH = FreeMotion.fit(PARABOLA, num_pieces=NUM_PIECES)
SPACES = {
    "mirrored": (scene(), NAMES),
    "one-sided": (scene(-700.0), NAMES),
    "panned": (scene(-700.0, max_pan=800.0), (*NAMES, "velocity")),
    "stage": (scene(**STAGE), NAMES),
    "panned stage": (scene(-700.0, **STAGE), (*NAMES, "velocity")),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", SPACES.values(), ids=SPACES)
def test_every_path_is_within_the_limits(case):
    """At corners and inside; some come to the stroke, and slopes are those of differences."""
    where, names = case
    space = design_space(where, PATH, RectShutter(), names)
    mirrored = "velocity" not in names and float(where.speeds[0]) == -4500
    assert space.num_path_coordinates == NUM_PIECES // (2 if mirrored else 1)

    @jax.jit
    def numbers(point):
        found = space.at(point)[1]
        assert isinstance(found, FreeMotion)
        return jnp.append(found.accelerations, jnp.stack([found.half_exposure, found.velocity]))

    random = np.random.default_rng(7)
    boxes = random.uniform(size=(16, space.size))
    boxes[:10] = np.round(boxes[:10])
    shares = []
    for point in boxes:
        *a, half, v = np.asarray(numbers(jnp.asarray(point)))
        found = FreeMotion(accelerations=np.array(a), half_exposure=half, velocity=v)
        assert not beyond_limits(where, found, RectShutter())
        larger = max(np.mean(gained) for gained in np.split(np.array(a), 2))
        assert float(found.speed_gain) == pytest.approx(2 * larger * half, rel=1e-12)
        assert found.mirrors or not mirrored
        shares.append(float(found.stroke) / NUMBERS["max_stroke"])
    assert max(shares) > (0.5 if STAGE["max_travel"] in (where.limits.max_travel,) else 0.99)
    inside = boxes[-1]
    slopes = np.asarray(jax.jacrev(numbers)(jnp.asarray(inside)))
    for index in range(space.size):
        step = 1e-6 * np.eye(space.size)[index]
        ends = (np.asarray(numbers(jnp.asarray(inside + sign * step))) for sign in (1, -1))
        difference = np.subtract(*ends) / 2e-6
        scale = np.abs(difference).max() + 1e-9
        np.testing.assert_allclose(slopes[:, index], difference, atol=1e-6 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("case", SPACES.values(), ids=SPACES)
def test_the_box_holds_what_it_gives(case):
    """A design's own place in the box is the place that it came from, path and all."""
    where, names = case
    space = design_space(where, PATH, TukeyShutter(0.4), ("shutter", *names))
    point = np.random.default_rng(3).uniform(0.2, 0.8, space.size)
    shutter, motion = space.at(jnp.asarray(point))
    again = space.at(space.point_of(shutter, motion))[1]
    assert isinstance(motion, FreeMotion)
    assert isinstance(again, FreeMotion)
    np.testing.assert_allclose(again.accelerations, motion.accelerations, rtol=1e-10)
    np.testing.assert_allclose(again.half_exposure, motion.half_exposure, rtol=1e-12)
    parabola = space.at(space.point_of(shutter, PARABOLA))[1]
    assert isinstance(parabola, FreeMotion)
    if where.limits.max_travel is None:
        np.testing.assert_allclose(parabola.accelerations, PATH.accelerations, rtol=1e-12)


def test_a_free_path_of_a_parabola_uses_a_stage_as_the_parabola_does():
    """Travel from rest to rest, panned or not, with an acceleration of the run-up and without."""
    for velocity in (0.0, 300.0, -4000.0):
        parabola = ParabolicMotion(acceleration=2e5, half_exposure=0.007, velocity=velocity)
        path = FreeMotion.fit(parabola, num_pieces=5)
        for most in (None, 5e5):
            limits = Limits(max_travel=90.0, max_acceleration=most)
            wanted = float(limits.stage_share_of(parabola))
            assert float(limits.stage_share_of(path)) == pytest.approx(wanted, rel=1e-12)


def test_travel_of_a_path_is_that_of_its_steps():
    """Run-up, exposure and run-out, stepped through in time, span what is told."""
    path = FreeMotion(accelerations=[3e5, -1e5, 2e5, 5e4], half_exposure=0.004, velocity=250.0)
    most = 8e5
    times = np.linspace(-0.004, 0.004, 200_001)
    x, u = np.asarray(path.position(times)), np.asarray(path.velocity_at(times))
    before = x[0] - np.sign(u[0]) * u[0] ** 2 / (2 * most)
    after = x[-1] + np.sign(u[-1]) * u[-1] ** 2 / (2 * most)
    wanted = max(*x, before, after) - min(*x, before, after)
    use = stage_use(path, most)
    assert stage_path(path, max_acceleration=most).travel == pytest.approx(wanted, rel=1e-9)
    assert float(use.travel) == pytest.approx(wanted, rel=1e-9)
    assert float(use.top_speed) == pytest.approx(np.max(np.abs(u)), rel=1e-12)


@pytest.fixture(scope="module")
def found():
    """Open shutters on the best parabola and on the best free path."""
    parabola = optimise(scene(), shutter=RectShutter())
    return parabola, optimise(scene(), shutter=RectShutter(), free={"path", "half_exposure"})


@pytest.mark.slow
def test_a_free_path_is_better_than_a_parabola(found):
    """By 0.1 dB, by the same loss, and on speeds four times as fine."""
    parabola, path = found
    assert isinstance(path.motion, FreeMotion)
    assert path.loss < 0.98 * parabola.loss
    assert path.loss == pytest.approx(
        float(ExpectedErrorLoss()(scene(), path.motion, path.shutter))
    )
    fine = scene(num_speeds=17)
    before, after = (
        float(evaluate(fine, each.motion, each.shutter).expected_psnr) for each in found
    )
    assert after > before + 0.1
    assert path.motion.mirrors
    assert not beyond_limits(scene(), path.motion, path.shutter)


@pytest.mark.slow
def test_a_comparison_has_an_open_shutter_on_a_free_path(found):
    """It is what a search for it alone finds, and what a stage alone brings."""
    own = {"own": TukeyShutter(0.6)}
    table = compare(scene(), found[0].motion, own, free_paths=True)
    row = table.row("open on a free path")
    assert row.loss == pytest.approx(found[1].loss, rel=1e-5)
    assert table.rivals["a stage"] is row
    assert max(each.level for each in table.rows) <= table.ceiling


@pytest.mark.slow
def test_a_search_goes_on_from_a_given_path(found):
    """It is no worse than the path it was given, whose number of pieces it keeps."""
    given = FreeMotion.fit(found[1].motion, num_pieces=4)
    on = optimise(scene(), given, RectShutter(), free={"path"}, max_steps=30)
    assert isinstance(on.motion, FreeMotion)
    assert on.motion.accelerations.size == 4
    assert on.loss <= float(ExpectedErrorLoss()(scene(), given, RectShutter()))


REFUSED = {
    "jerk": (scene(max_jerk=1e10), PARABOLA, "jerk"),
    "still": (scene(), StillCamera(half_exposure=0.01), "still camera"),
    "odd": (scene(), FreeMotion.fit(PARABOLA, num_pieces=5), "even number of equal pieces"),
    "unequal": (
        scene(),
        FreeMotion(accelerations=[1e5, 2e5], half_exposure=0.01, durations=[1.0, 3.0]),
        "even number of equal pieces",
    ),
    "tolerances": (
        Scene(
            [-900.0, 900.0],
            photon_rate=1e5,
            read_noise=2.0,
            tolerances=Tolerances(acceleration=0.01),
        ),
        PARABOLA,
        "tolerances",
    ),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_has_no_free_path_is_refused_by_name(case):
    """One line that says what must hold."""
    where, motion, said = case
    with pytest.raises(ValueError, match=said):
        optimise(where, motion, HannShutter(), free="path", max_steps=3)


def test_the_coordinate_of_an_exposure_comes_back():
    """Below and above the one at which a path comes to its stroke and its top speed together."""
    space = design_space(scene(), PATH, RectShutter(), NAMES)
    for share in (0.2, 0.5, 0.7, 0.95):
        point = jnp.full(space.size, 0.6).at[space.num_path_coordinates].set(share)
        back = space.point_of(*space.at(point))
        assert float(back[space.num_path_coordinates]) == pytest.approx(share, abs=1e-6)
