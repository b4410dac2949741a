"""The search: never worse than its starts, the same minimum by another solver, honest ends."""

import inspect
import re
import sys
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import FREE_NAMES, LIMITS, MOTION, OUTLIER, SCENE, SLOW, SMALL
from support.helpers import ROUNDING

from mishutter import (
    AbstractLoss,
    DesignLoss,
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    LinearMotion,
    NonFiniteLossError,
    Outcome,
    ParabolicMotion,
    RectShutter,
    Scene,
    SearchFailedError,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    evaluate,
    example_scene,
    optimise,
    starting_shutter,
)
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.needs import needed_speeds, reduced

# Steps of the search, checked one by one; its face returns only a finished design.
from mishutter.search.objective import DesignObjective, LinearObjective, objective_of
from mishutter.search.planning import plan
from mishutter.search.search import free_by_default
from mishutter.search.solvers import (
    Polished,
    certificate_at,
    losses_at,
    minimise,
    polish,
    projected_gradient_norm,
)
from mishutter.search.space import all_that_can_move, beyond_limits, design_space
from mishutter.search.starts import lowest_places, start_boxes

PROFILE = SplineShutter.fit(TukeyShutter(0.45), 10, symmetric=True)
LOSSES = {"design": DesignLoss(), "expected_error": ExpectedErrorLoss()}


def _objective(loss, free, shutter=PROFILE):
    space = design_space(SCENE, MOTION, shutter, free)
    return space, objective_of(loss, needed_speeds(SCENE, MOTION, shutter), space, SMALL)


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_the_sum_of_responses_is_the_loss_itself(slug):
    """The precomputed form of a profile search agrees with the loss of each design."""
    space, linear = _objective(LOSSES[slug], ("shutter",))
    assert isinstance(linear, LinearObjective)
    direct = DesignObjective(LOSSES[slug], SCENE.without_metadata(), space, SMALL)
    boxes = start_boxes(space, 4, seed=3)
    values = [float(direct(jnp.asarray(point))) for point in boxes]
    assert np.allclose(losses_at(linear, boxes), values, rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_an_independent_solver_finds_the_same_minimum(slug):
    """The box-constrained solver of the polish, from its own starts, agrees to 1e-3 of the loss."""
    design = optimise(SCENE, MOTION, PROFILE, loss=LOSSES[slug], free="shutter", num_starts=12)
    space, objective = _objective(LOSSES[slug], ("shutter",))
    rivals = [
        polish(objective, point, max_steps=400).loss
        for point in start_boxes(space, 12, seed=99)[1:]
    ]
    found = float(objective(space.point_of(design.shutter, design.motion)))
    assert abs(found - min(rivals)) < 1e-3 * min(rivals)
    assert design.loss <= design.best_start_loss
    assert design.converged, design.outcome
    assert np.all(np.diff(design.history) <= 0)


@pytest.mark.slow
def test_a_joint_search_keeps_every_bound():
    """Stroke, top speed and exposure stay within their limits, and the best start is kept."""
    design = optimise(SCENE, MOTION, PROFILE, loss=ExpectedErrorLoss(), num_starts=4, max_steps=40)
    assert float(design.motion.stroke) <= float(LIMITS.max_stroke) * (1 + 1e-12)
    assert float(design.motion.top_speed) <= float(LIMITS.max_top_speed) * (1 + 1e-12)
    half = float(design.motion.half_exposure)
    assert float(LIMITS.min_half_exposure) <= half <= float(LIMITS.max_half_exposure)
    assert design.loss <= design.best_start_loss
    tau = jnp.linspace(-1, 1, 301)
    profile = design.shutter.transmittance(tau)
    assert bool(jnp.all((profile >= 0) & (profile <= 1)))


@pytest.mark.parametrize("half_exposure", [5e-4, 7e-3, 3e-2])
@pytest.mark.parametrize("stroke", [0.004, 0.7, 3.0])
def test_a_start_within_the_limits_is_a_point_of_the_box(stroke, half_exposure):
    """Also one that is slower than the fastest object, or than all but a shiver."""
    motion = ParabolicMotion(acceleration=stroke / half_exposure**2, half_exposure=half_exposure)
    space = design_space(SCENE, motion, PROFILE, ("acceleration", "half_exposure"))
    _, found = space.at(space.point_of(PROFILE, motion))
    assert np.isclose(found.acceleration, motion.acceleration, rtol=1e-13)
    assert np.isclose(found.half_exposure, motion.half_exposure, rtol=1e-13)


@pytest.mark.parametrize("free", [FREE_NAMES[1:], ("acceleration",), ("half_exposure",)])
@pytest.mark.parametrize("acceleration", [2e4, 3e5, 5e6])
def test_a_corner_of_the_box_uses_up_the_limits(free, acceleration):
    """All corners are within, and the farthest is at one: of exposure, stroke or top speed."""
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=1e-3)
    space = design_space(SCENE, motion, HannShutter(), free)
    corners = [space.at(jnp.asarray(point, float))[1] for point in np.ndindex(*[2] * space.size)]
    assert not any(beyond_limits(SCENE, corner, HannShutter()) for corner in corners)
    last = corners[-1]
    shares = last.stroke / 30.0, last.top_speed / 2e4, last.half_exposure / 0.03
    assert max(shares) == pytest.approx(1, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("free", [FREE_NAMES[1:], ("acceleration",), ("half_exposure",)])
@pytest.mark.parametrize("half_exposure", [1e-3, 1.7e-2])
def test_the_slope_at_a_corner_of_the_box_is_that_inside(free, half_exposure):
    """A solver at a bound sees where to leave it: rounding into the limits bends nothing."""
    motion = ParabolicMotion(acceleration=7e4, half_exposure=half_exposure)
    space = design_space(SCENE, motion, HannShutter(), free)

    def logarithms(point):
        _, found = space.at(point)
        return jnp.log(jnp.stack([found.half_exposure, found.acceleration]))

    slopes = jax.jacfwd(logarithms)
    for corner in np.ndindex(*[2] * space.size):
        point = np.array(corner, float)
        inside = np.clip(point, 1e-7, 1 - 1e-7)
        np.testing.assert_allclose(slopes(point), slopes(inside), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("corner", [0.0, 1.0])
def test_a_polish_leaves_the_bound_that_it_began_at(corner):
    """The shortest and the longest exposure are no minima, and are not certified as such."""
    space, objective = _objective(ExpectedErrorLoss(), ("half_exposure",), RectShutter())
    # At shorter exposures, where the sensor keeps up with less, lies another and worse minimum.
    inside = polish(objective, np.array([0.85]), max_steps=100)
    found = polish(objective, np.array([corner]), max_steps=100)
    assert certificate_at(objective, np.array([corner]), space.bends) > 0.01
    assert found.loss == pytest.approx(inside.loss, rel=1e-6)


@pytest.mark.slow
def test_a_polish_goes_as_far_in_any_unit():
    """A loss of another unit ends at the same point: 1/8192 of it has the same digits."""
    loss, unit = ExpectedErrorLoss(), 2.0**-13
    ends = []
    for each in (loss, unit * loss):
        space, objective = _objective(each, ("shutter", "half_exposure"))
        point = start_boxes(space, 5, seed=3)[4]
        ends.append(polish(objective, point, max_steps=80))
    np.testing.assert_allclose(ends[1].point, ends[0].point, atol=1e-6)
    assert ends[1].loss == pytest.approx(unit * ends[0].loss, rel=1e-9)


NEAR_A_LIMIT = {
    "stroke": lambda x: (30.0 / 1e-4 * x, 0.01),
    "top speed": lambda x: (1e7 * x, 1e-3),
    "longest exposure": lambda x: (1e3, 0.03 * x),
    "shortest exposure": lambda x: (1e3, 5e-4 / x),
}


@pytest.mark.parametrize("slug", NEAR_A_LIMIT)
def test_what_is_within_the_limits(slug):
    """Whatever is beyond one of them by no more than a millionth of it."""
    for beyond, within in ((1e-7, True), (1e-5, False)):
        a, half = NEAR_A_LIMIT[slug](1 + beyond)
        motion = ParabolicMotion(acceleration=a, half_exposure=half)
        assert (not beyond_limits(SCENE, motion, HannShutter())) == within


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shutter", "free"),
    [(HannShutter(), ("acceleration", "half_exposure")), (TukeyShutter(0.5), None)],
)
def test_a_grid_leads_to_the_lowest_of_its_minima(shutter, free):
    """Polished from every point of the grid by the whole loss, none ends lower."""
    loss = ExpectedErrorLoss()
    design = optimise(SCENE, MOTION, shutter, loss=loss, free=free)
    found = plan(SCENE, MOTION, shutter, loss=loss, free=free_by_default(SCENE, MOTION, shutter))
    space = design_space(SCENE, MOTION, shutter, free or free_by_default(SCENE, MOTION, shutter))
    objective = objective_of(loss, needed_speeds(SCENE, MOTION, shutter), space, found.sizes)
    ends = [polish(objective, point, max_steps=300).loss for point in start_boxes(space, 1, 0)]
    assert design.converged, design.outcome
    assert design.loss <= min(ends) * (1 + 1e-7)


def test_places_of_a_grid_are_tried_valley_by_valley():
    """The lowest of each valley, corners among them, before what lies beside a lower one."""
    losses = np.full((5, 9), 4.0)
    losses[0, 0], losses[3, 4], losses[3, 5], losses[4, 8] = 1.0, 0.5, 0.6, 2.0
    places = lowest_places(np.append(3.0, losses))
    at = [1 + 9 * row + column for row, column in ((3, 4), (0, 0), (4, 8))]
    assert places[:4].tolist() == [*at, 0]
    assert places.tolist().index(1 + 9 * 3 + 5) > 4
    assert sorted(places) == list(range(46))
    ends = start_boxes(design_space(SCENE, MOTION, HannShutter(), FREE_NAMES[1::2]), 1, 0)[1:]
    assert ends.shape == (45, 2)
    assert {0.0, 1.0} <= set(ends.ravel().tolist())


@pytest.mark.slow
def test_the_best_tukey_is_found_where_the_loss_is_jagged():
    """A condition number rises and falls with every pixel of stroke: no rect is better."""
    loss, scene = (
        DesignLoss(),
        Scene.uniform(
            max_speed=2000.0, num_speeds=9, photon_rate=1e5, read_noise=10.0, limits=LIMITS
        ),
    )
    free = "half_exposure", "acceleration"
    rect = optimise(scene, MOTION, RectShutter(), loss=loss, free=free)
    tukey = optimise(scene, MOTION, TukeyShutter(0.5), loss=loss, free=("shutter", *free))
    assert tukey.loss <= rect.loss * (1 + 1e-9)


@pytest.mark.slow
def test_a_loss_without_an_eye_for_light_moves_the_profile_alone():
    """On the motion given, the scene's, or that of the best design by the expected error."""
    loss, search = DesignLoss(), {"num_starts": 2, "max_steps": 20}
    given = optimise(SCENE, MOTION, PROFILE, loss=loss, **search)
    assert float(given.motion.stroke) == float(MOTION.stroke)
    assert given.loss <= float(loss(SCENE, MOTION, PROFILE))
    bright = optimise(SCENE, shutter=TukeyShutter(0.5))
    free = optimise(SCENE, shutter=TukeyShutter(0.5), loss=loss, **search)
    assert float(free.motion.exposure) == float(bright.motion.exposure)
    assert free.loss <= float(loss(SCENE, bright.motion, bright.shutter)) * (1 + ROUNDING)
    assert (loss + ExpectedErrorLoss()).sees_light
    assert not (2 * loss + 0 * ExpectedErrorLoss()).sees_light


@pytest.mark.slow
@pytest.mark.parametrize("free", ["acceleration", ("acceleration", "half_exposure")])
def test_a_start_that_gives_up_an_outlier_is_not_made_worse(free):
    """Rare objects that a motion of less stroke leaves behind: the search may do as it does."""
    loss, shutter = ExpectedErrorLoss(), RectShutter()
    design = optimise(OUTLIER, SLOW, shutter, loss=loss, free=free)
    given = float(value_of(loss, OUTLIER, SLOW, shutter, SMALL))
    assert design.best_start_loss <= given * (1 + ROUNDING)
    assert design.loss <= design.best_start_loss


@pytest.mark.parametrize(
    ("motion", "shutter", "names"),
    [
        (MOTION, PROFILE, FREE_NAMES),
        (MOTION, HannShutter(), FREE_NAMES[1:]),
        (StillCamera(half_exposure=1e-3), PROFILE, ("shutter", "half_exposure")),
        (ParabolicMotion(acceleration=0.0, half_exposure=1e-3), RectShutter(), ("half_exposure",)),
        (LinearMotion(half_exposure=1e-3, velocity=9.0), RectShutter(), FREE_NAMES[1:3]),
    ],
)
def test_all_that_can_move(motion, shutter, names):
    """By default a fixed window is held, and a camera at rest stays there."""
    assert all_that_can_move(SCENE, motion, shutter) == names


@pytest.mark.parametrize(("pans", "velocity"), [("stage", 0.0), ("camera", 900.0)])
def test_nothing_pans_without_a_stage(pans, velocity):
    """A stroke of 0 is none, not one of a thousandth of a pixel, unless the camera turns."""
    limits = Limits(max_stroke=0.0, max_top_speed=5e3, max_half_exposure=0.01, pans=pans)
    assert float(limits.fullest_motion(900.0).velocity) == velocity
    motion = LinearMotion(half_exposure=1e-3, velocity=9.0)
    names = all_that_can_move(replace(SCENE, limits=limits), motion, RectShutter())
    assert ("velocity" in names) == (velocity > 0)


@pytest.mark.parametrize("at_rest", [StillCamera, partial(ParabolicMotion, acceleration=0.0)])
def test_a_camera_at_rest_stays_there(at_rest):
    """Without a word about what is free, by either way to say that it is still."""
    design = optimise(SCENE, at_rest(half_exposure=1e-3), RectShutter(), loss=ExpectedErrorLoss())
    assert design.motion.is_straight
    assert design.motion.velocity == 0
    assert design.converged


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stroke", "free", "is_outside"),
    [(44.0, "half_exposure", False), (44.0, "shutter", True), (29.0, "shutter", False)],
)
def test_a_held_motion_outside_the_limits_is_told_of(stroke, free, is_outside):
    """It is not moved into them, and the outcome says so."""
    motion = ParabolicMotion(acceleration=stroke / 1e-4, half_exposure=1e-2)
    shutter = TukeyShutter(0.45)
    design = optimise(SCENE, motion, shutter, loss=ExpectedErrorLoss(), free=free)
    assert ("outside the scene's limits" in design.ending) == is_outside
    assert (float(design.motion.stroke) > float(LIMITS.max_stroke)) == is_outside


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_starting_profile_is_as_precise_as_the_speeds(dtype):
    """A scene in single precision starts from a profile in single precision."""
    scene = Scene(np.array([-310.0, 0.0, 520.0], dtype), photon_rate=1e5, read_noise=4.0)
    shutter = starting_shutter(scene, 7)
    assert shutter.parameters.dtype == dtype
    twice = SplineShutter.fit(TukeyShutter(0.5), 7).parameters
    assert np.array_equal(shutter.parameters, twice.astype(dtype))


_SHUTTERS = {"spline": SplineShutter.fit(TukeyShutter(0.45), 10), "tukey": TukeyShutter(0.3)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "free"),
    [
        ("spline", ("shutter",)),
        ("spline", FREE_NAMES),
        ("tukey", ("half_exposure",)),
        ("tukey", FREE_NAMES),
    ],
)
def test_a_search_is_as_precise_as_the_scene_and_the_motion(slug, free):
    """Single precision stays so where JAX's default is double, whatever the shutter's is."""
    speeds, single = np.array([-310.0, 0.0, 520.0], np.float32), np.float32
    scene = Scene(speeds, photon_rate=single(1e5), read_noise=single(4))
    motion = ParabolicMotion(acceleration=single(1e5), half_exposure=single(1e-2))
    options = {"loss": ExpectedErrorLoss(), "free": free, "num_starts": 2, "max_steps": 3}
    design = optimise(scene, motion, _SHUTTERS[slug], **options)
    assert design.motion.half_exposure.dtype == np.float32
    exact = float(ExpectedErrorLoss()(scene, design.motion, design.shutter))
    assert np.isclose(design.loss, exact, rtol=1e-5)


@pytest.mark.slow
def test_responses_of_a_double_motion_are_double():
    """Those of each coordinate are the records of its profile, though speeds are single."""
    speeds = np.array([-310.0, 0.0, 520.0], np.float32)
    scene = reduced(Scene(speeds, photon_rate=1e5, read_noise=4.0), SMALL)
    space = design_space(scene, MOTION, _SHUTTERS["spline"], "shutter")
    loss = ExpectedErrorLoss()
    linear = objective_of(loss, scene, space, SMALL)
    direct = DesignObjective(loss, scene, space, SMALL)
    boxes = start_boxes(space, 4, seed=3)
    assert np.allclose(losses_at(linear, boxes), losses_at(direct, boxes), rtol=1e-12, atol=0)


class _NotFinite(AbstractLoss):
    """The root of a value that is exactly zero: finite, with an infinite derivative."""

    def __call__(self, scene, motion, shutter):
        return jnp.sqrt(jnp.maximum(shutter.efficiency() - 2, 0.0)) + motion.stroke * 0


@pytest.mark.parametrize("shutter", [PROFILE, TukeyShutter(0.3)], ids=["spline", "tukey"])
def test_a_gradient_that_is_not_finite_is_an_error(shutter):
    """Never a silent stall: the search stops and names what is wrong."""
    with pytest.raises(NonFiniteLossError, match="must be finite; got a NaN or an infinity"):
        optimise(SCENE, MOTION, shutter, loss=_NotFinite(), free="shutter")


class _Returns(AbstractLoss):
    """What a user's loss may give by mistake, or a plain number."""

    what: str

    def __call__(self, scene, motion, shutter):
        light = shutter.efficiency()
        pair, wave = jnp.stack([light, motion.stroke]), jax.lax.complex(light, light)
        return {"pair": pair, "wave": wave, "none": None, "number": 0.75}[self.what]


@pytest.mark.parametrize(
    ("what", "got"),
    [("pair", "float64 of shape (2,)"), ("wave", "complex128 of shape ()"), ("none", "NoneType")],
)
def test_a_loss_that_is_not_one_number_is_named(what, got):
    """A mistake in a user's own loss is one line that names its class and what it gave."""
    line = f"`_Returns.__call__` must give one real number; got '{got}'."
    with pytest.raises(ValueError, match=re.escape(line)):
        optimise(SCENE, MOTION, PROFILE, loss=_Returns(what))


@pytest.mark.parametrize("free", ["shutter", "half_exposure"])
def test_a_loss_that_is_a_plain_number_is_flat(free):
    """A user's loss that depends on nothing converges where it began."""
    options = {"num_starts": 2}
    design = optimise(SCENE, MOTION, PROFILE, loss=_Returns("number"), free=free, **options)
    assert design.loss == 0.75
    assert design.converged


def _open_for_long(scene, motion, shutter):
    """The expected error, and a price of every moment at which the shutter is closed."""
    return ExpectedErrorLoss()(scene, motion, shutter) + 0.01 * (1 - shutter.efficiency())


def _known_speed(scene, motion, shutter):
    """The level that a decoder reaches which knows each speed."""
    return -evaluate(scene, motion, shutter).known_speed_psnr


FOUR_SPEEDS = Scene([-310.0, -120.0, 120.0, 310.0], photon_rate=1e5, read_noise=5.0)
SHORT_STROKE = eqx.tree_at(lambda s: s.limits.max_stroke, FOUR_SPEEDS, np.asarray(7.3))
OWN_LOSSES = {
    "compiled": (jax.jit(_open_for_long), [SHORT_STROKE, FOUR_SPEEDS]),
    "metrics": (_known_speed, [None]),
}
"""Losses, and scenes in turn: what is compiled once meets more light at the second.

None is the built-in scene.
"""
OWN_FREQUENCIES = 1e-3
"""Difference of a loss that picks its frequencies by a motion that it knows, and in a search by all
motions: either number of them is good to 0.01 dB."""


@pytest.mark.slow
@pytest.mark.parametrize("slug", OWN_LOSSES)
def test_a_loss_of_the_package_s_own_functions_is_searched(slug):
    """It is searched over all that can move, wherever light falls there, from scene to scene."""
    loss, scenes = OWN_LOSSES[slug]
    for searched in (scene or example_scene() for scene in scenes):
        design = optimise(searched, loss=loss, num_starts=2, max_steps=4)
        value = float(loss(searched, design.motion, design.shutter))
        np.testing.assert_allclose(value, design.loss, rtol=OWN_FREQUENCIES)
        assert design.loss <= design.best_start_loss


@pytest.mark.slow
def test_a_search_is_the_same_on_any_number_of_processors(monkeypatch):
    """Points are minimised from one by one, so that threads do not change their roundings."""
    designs = []
    # The number of processors is that of the machine.
    for count in (1, 3):
        monkeypatch.setattr(
            sys.modules["mishutter.search.search"], "num_processors", lambda count=count: count
        )
        designs.append(optimise(SCENE, MOTION, PROFILE, num_starts=6, max_steps=25))
    one, several = designs
    assert several.loss == one.loss
    np.testing.assert_array_equal(several.history, one.history)


@pytest.mark.slow
def test_a_minimum_in_the_angles_is_that_of_the_polish():
    """From the middle of the box, and from a corner, that the bounded solver leaves too."""
    space, objective = _objective(ExpectedErrorLoss(), ("shutter", "half_exposure"))
    for start in (np.full(space.size, 0.5), np.zeros(space.size)):
        point, num_steps = minimise(objective, start, max_steps=300)
        assert 1 < num_steps < 300
        assert np.all((point >= 0) & (point <= 1))
        end = polish(objective, start, max_steps=300)
        assert losses_at(objective, point[None])[0] <= end.loss * (1 + 1e-4)
    assert minimise(objective, np.full(space.size, 0.5), max_steps=3)[1] == 3


@pytest.mark.slow
def test_a_search_for_a_profile_tells_how_far_it_is():
    """Steps ascend, the loss never does, and the last is that of the design."""
    calls = []
    design = optimise(
        SCENE, MOTION, PROFILE, free="shutter", progress=lambda *call: calls.append(call)
    )
    steps, losses = zip(*calls, strict=True)
    assert len(calls) > 4
    assert all(np.diff(steps) >= 0)
    assert all(np.diff(losses) <= 0)
    np.testing.assert_allclose(losses[-1], design.loss, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e-5])
def test_a_search_that_is_cut_short_says_so(unit):
    """Steps used up, in a loss of any unit: `throw` raises, otherwise the outcome says how."""
    loss = DesignLoss(condition=0.1 * unit, invariance=unit, efficiency=unit)
    arguments = {"loss": loss, "free": "shutter", "num_starts": 2, "max_steps": 1}
    design = optimise(SCENE, MOTION, PROFILE, **arguments)
    assert not design.converged
    assert design.outcome in (Outcome.STEPS_USED, Outcome.STALLED)
    assert design.loss <= design.best_start_loss
    with pytest.raises(SearchFailedError, match="The search"):
        optimise(SCENE, MOTION, PROFILE, throw=True, **arguments)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"free": ()}, "name some of"),
        ({"free": ("profile",)}, "name some of"),
        ({"free": "shutter", "shutter": HannShutter()}, "have parameters"),
        (
            {"motion": StillCamera(half_exposure=1e-3), "free": "acceleration"},
            "leave a still camera at rest",
        ),
        ({"num_starts": 0}, "be a positive integer"),
        ({"max_steps": -3}, "be a positive integer"),
        ({"seed": -1}, "be a whole number of at least 0; got -1"),
    ],
)
def test_what_cannot_be_searched_is_refused(arguments, text):
    """Each mistake in the call is one line that names the argument."""
    call = {"motion": MOTION, "shutter": PROFILE, "loss": DesignLoss()} | arguments
    motion, shutter = call.pop("motion"), call.pop("shutter")
    with pytest.raises(ValueError, match=text):
        optimise(SCENE, motion, shutter, **call)


def test_a_name_is_no_shutter():
    """The line says what is one; where annotations are not checked it comes before all."""
    with pytest.raises(ValueError, match=r"must be a shutter, as `HannShutter\(\)`; got 'hann'"):
        inspect.unwrap(optimise)(SCENE, None, "hann")


def test_certificate_is_zero_at_a_corner_that_pushes_outwards():
    """A gradient out of the box certifies its corner; one into it does not."""
    corner = np.array([0.0, 1.0])
    assert projected_gradient_norm(corner, np.array([2.0, -3.0])) == 0
    assert projected_gradient_norm(corner, np.array([-0.25, -3.0])) == 0.25


@pytest.mark.slow
def test_the_certificate_is_that_of_the_design_returned(monkeypatch):
    """A polish that makes things worse is thrown away, and its certificate with it."""

    def spoiled(objective, point, *, max_steps):
        return Polished(
            point=point, loss=np.inf, certificate=0.0, history=np.full(max_steps, np.inf)
        )

    # No polish of a scene is known to make things worse.
    monkeypatch.setattr(sys.modules["mishutter.search.search"], "polish", spoiled)
    loss = ExpectedErrorLoss()
    design = optimise(SCENE, MOTION, TukeyShutter(0.5), loss=loss, free="shutter")
    assert np.isfinite(design.loss)
    assert design.certificate > 0


def test_a_scene_is_enough():
    """`optimise(scene)` moves a free profile and the scene's motion, by the expected error."""
    options = {"num_starts": 2, "max_steps": 3}
    found = optimise(SCENE, **options)
    start = starting_shutter(SCENE)
    spelled = optimise(SCENE, SCENE.motion, start, loss=ExpectedErrorLoss(), **options)
    assert found.loss == spelled.loss
    assert found.loss_name == spelled.loss_name
    assert np.array_equal(found.shutter.coefficients, spelled.shutter.coefficients)
