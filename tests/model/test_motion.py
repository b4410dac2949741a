"""A parabola without acceleration is a pan, or a camera at rest: one class, by its numbers."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import SCENE, SMALL

import mishutter
from mishutter import (
    ExpectedErrorLoss,
    FreeMotion,
    HannShutter,
    LinearMotion,
    ParabolicMotion,
    StillCamera,
    TukeyShutter,
    binned_exposure,
    transfer_function,
)
from mishutter.evaluation.losses import value_of
from mishutter.model.motion import AbstractMotion

HALF, PAN = 0.0021, -310.7


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_constructors_make_parabolas_without_acceleration(dtype):
    """In the precision of the exposure, equal to what `ParabolicMotion` makes of a plain 0."""
    half, pan = dtype(HALF), dtype(PAN)
    straight = LinearMotion(half_exposure=half, velocity=pan)
    still = StillCamera(half_exposure=half)
    expected = ParabolicMotion(acceleration=0, half_exposure=half, velocity=pan)
    assert eqx.tree_equal(straight, expected)
    assert eqx.tree_equal(straight.without_velocity(), still)
    assert {leaf.dtype for leaf in jax.tree.leaves((straight, still))} == {np.dtype(dtype)}


@pytest.mark.parametrize("make", [StillCamera, LinearMotion])
def test_errors_name_the_constructor(make):
    """Not the class that it makes."""
    subject = rf"`{make.__name__}\(half_exposure=...\)` must be above 0 s; got -0.3"
    with pytest.raises(ValueError, match=subject):
        make(half_exposure=-0.3)


def test_what_a_search_leaves_follows_from_numbers_that_are_known():
    """Whoever made the motion; a traced acceleration may be any."""
    straight, still = {"acceleration"}, {"acceleration", "velocity"}
    for motion, names in (
        (LinearMotion(half_exposure=HALF, velocity=PAN), straight),
        (ParabolicMotion(acceleration=0.0, half_exposure=HALF, velocity=PAN), straight),
        (FreeMotion(accelerations=[0.0, 0.0], half_exposure=HALF, velocity=PAN), straight),
        (StillCamera(half_exposure=HALF), still),
        (ParabolicMotion(acceleration=1e-16, half_exposure=HALF), still),
        (ParabolicMotion(acceleration=7e4, half_exposure=HALF), set()),
    ):
        assert motion.fixed.names == names
    traced = []
    jax.jit(lambda m: traced.append(m.fixed.names))(StillCamera(half_exposure=HALF))
    assert traced == [set()]
    within = []
    jax.jit(lambda half: within.append(StillCamera(half_exposure=half).fixed.names))(HALF)
    assert within == [still]


def test_motions_are_parabolas_or_free_paths():
    """The kernel knows no other, so that no class of a user's own is invited."""
    assert not hasattr(mishutter, "AbstractMotion")
    assert set(AbstractMotion.__subclasses__()) == {ParabolicMotion, FreeMotion}


def _kernel(motion):
    edges = np.linspace(-4.0, 4.0, 9)
    return binned_exposure(TukeyShutter(0.43), motion, speed=1300.0, edges=edges)


def _spectrum(motion):
    f = jnp.array([0.07, 0.31])
    values = transfer_function(HannShutter(), motion, speed=1300.0, frequency=f)
    return jnp.concatenate([values.real, values.imag])


def _loss(motion):
    return value_of(ExpectedErrorLoss(), SCENE, motion, TukeyShutter(0.43), SMALL)


def test_slopes_without_acceleration_are_those_beside_it():
    """By all three numbers of a pan, against differences; that by $a$ on its one side."""
    motion = LinearMotion(half_exposure=HALF, velocity=PAN)
    slopes = jax.jacfwd(_spectrum)(motion)
    for name, step in (("acceleration", 20.0), ("half_exposure", 1e-7), ("velocity", 0.02)):
        number = float(getattr(motion, name))

        def at(steps, name=name, number=number, step=step):
            moved = {"acceleration": 0.0, "half_exposure": HALF, "velocity": PAN}
            return np.asarray(_spectrum(ParabolicMotion(**moved | {name: number + steps * step})))

        one_sided = (-3 * at(0) + 4 * at(1) - at(2)) / (2 * step)
        scale = np.max(np.abs(one_sided))
        found = np.asarray(getattr(slopes, name))
        np.testing.assert_allclose(found, one_sided, rtol=0, atol=1e-4 * scale, err_msg=name)


@pytest.mark.parametrize("function", [_kernel, pytest.param(_loss, marks=pytest.mark.slow)])
def test_known_and_traced_motions_without_acceleration_give_one_slope(function):
    """By the exposure of a camera at rest: made inside of what JAX traces, and passed into it."""
    inside = jax.jacfwd(lambda half: function(StillCamera(half_exposure=half)))(HALF)
    still = StillCamera(half_exposure=HALF)
    passed = jax.jacfwd(function)(still).half_exposure
    scale = float(np.max(np.abs(inside)))
    assert scale > 0
    np.testing.assert_allclose(passed, inside, rtol=0, atol=1e-12 * scale)


@pytest.mark.parametrize("velocity", [0.0, 613.0, -2900.0, 7700.0])
def test_stroke_is_from_the_lowest_to_the_highest_position(velocity):
    """With the pan, whether the path turns or not; the sag is that beside the pan."""
    motion = ParabolicMotion(acceleration=2.1e5, half_exposure=0.0097, velocity=velocity)
    time = np.linspace(-0.0097, 0.0097, 200_001)
    position = np.asarray(motion.position(time))
    assert float(motion.stroke) == pytest.approx(np.ptp(position), rel=1e-8)
    assert float(motion.sag) == pytest.approx(np.ptp(position - velocity * time), rel=1e-8)
    path = FreeMotion.fit(motion, num_pieces=5)
    assert float(path.stroke) == pytest.approx(float(motion.stroke), rel=1e-12)
    assert float(path.sag) == pytest.approx(float(motion.sag), rel=1e-12)


@pytest.mark.parametrize("velocity", [0.0, 613.0, -2900.0])
def test_a_motion_is_made_of_a_stroke_or_of_a_sag(velocity):
    """It has the length that it is made of, and is the one whose own length that is."""
    numbers = {"half_exposure": 0.0097, "velocity": velocity}
    by_stroke = ParabolicMotion.from_stroke(61.7, **numbers)
    by_sag = ParabolicMotion.from_sag(20.3, **numbers)
    assert float(by_stroke.stroke) == pytest.approx(61.7, rel=1e-14)
    assert float(by_sag.sag) == pytest.approx(20.3, rel=1e-14)
    again = ParabolicMotion.from_stroke(by_sag.stroke, **numbers)
    assert float(again.acceleration) == pytest.approx(float(by_sag.acceleration), rel=1e-12)
    assert by_stroke.velocity == by_sag.velocity == velocity


def test_lengths_of_a_motion_are_differentiable():
    """The slope of the acceleration by the stroke is one over that of the stroke by it."""

    def acceleration(stroke):
        numbers = {"half_exposure": 0.0097, "velocity": 2900.0}
        return ParabolicMotion.from_stroke(stroke, **numbers).acceleration

    def stroke(a):
        return ParabolicMotion(acceleration=a, half_exposure=0.0097, velocity=2900.0).stroke

    at, slope = jax.value_and_grad(acceleration)(61.7)
    assert float(slope * jax.grad(stroke)(at)) == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_motion_of_a_length_is_in_the_precision_of_its_numbers(dtype):
    """A plain number beside them adapts."""
    for make in (ParabolicMotion.from_stroke, ParabolicMotion.from_sag):
        motion = make(37.0, half_exposure=dtype(HALF), velocity=dtype(PAN))
        assert {leaf.dtype for leaf in jax.tree.leaves(motion)} == {np.dtype(dtype)}


@pytest.mark.parametrize(
    ("make", "length", "message"),
    [
        ("from_stroke", 57.9, "must be at least 58 px, which the pan takes; got 57.9"),
        ("from_stroke", np.ones(2), "must be a scalar; got shape (2,)"),
        ("from_sag", -0.3, "must be at least 0 px; got -0.3"),
        ("from_sag", np.nan, "must be finite; got nan"),
    ],
)
def test_lengths_that_no_motion_has_are_refused(make, length, message):
    """By the name of the constructor."""
    subject = f"`ParabolicMotion.{make}({make.removeprefix('from_')}=...)` {message}"
    with pytest.raises(ValueError, match=re.escape(subject)):
        getattr(ParabolicMotion, make)(length, half_exposure=0.01, velocity=-2900.0)


def test_a_traced_stroke_that_its_pan_exceeds_is_an_error():
    """When it is run; one that is long enough is solved as if it were known."""

    @eqx.filter_jit
    def made(stroke):
        return ParabolicMotion.from_stroke(stroke, half_exposure=0.01, velocity=-2900.0)

    known = ParabolicMotion.from_stroke(61.7, half_exposure=0.01, velocity=-2900.0)
    assert float(made(jnp.asarray(61.7)).acceleration) == pytest.approx(
        float(known.acceleration), rel=1e-12
    )
    with pytest.raises(eqx.EquinoxRuntimeError, match="no less than the least, which the pan"):
        made(jnp.asarray(57.9))
