"""A shutter of one's own is exact between the discontinuities it declares, and may be designed."""

import re
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import SCENE

from mishutter import (
    AbstractShutter,
    Design,
    ParabolicMotion,
    RectShutter,
    TriangleShutter,
    blur_kernel,
    compare,
    condition_number,
    example_scene,
    optimise,
    register_shutter,
    transfer_function,
)

# The registry itself, which each test leaves as it was.
from mishutter.model.shutters import kinds
from mishutter.model.shutters.base import at_coordinates, coordinates, is_adjustable, piecewise

ROUNDING = 2e-15
"""A sum of a few numbers up to 1."""
ACCELERATION, HALF_EXPOSURE, SPEED, NUM_TAPS = 3.1e5, 5.5e-3, 713.0, 24
FREQUENCIES = np.array([0.03, 0.11, 0.37])


@final
class Slit(AbstractShutter):
    """Open about mid-exposure; says nothing of where it jumps."""

    half_width: jax.Array

    def transmittance(self, tau):
        tau = jnp.asarray(tau)
        return jnp.where(jnp.abs(tau) <= jnp.asarray(self.half_width, tau.dtype), 1.0, 0.0)


@final
class DeclaredSlit(AbstractShutter):
    """The same, and says where it jumps and how wide it may be."""

    half_width: jax.Array

    def transmittance(self, tau):
        tau = jnp.asarray(tau)
        return jnp.where(jnp.abs(tau) <= jnp.asarray(self.half_width, tau.dtype), 1.0, 0.0)

    def discontinuities(self):
        return self.half_width, -self.half_width

    def bounds(self):
        return {"half_width": (0.05, 1.0)}


@final
class LeafShutter(AbstractShutter):
    """Opens and closes along straight ramps."""

    flat: float = 0.4
    ramp: float = 0.25

    def transmittance(self, tau):
        return jnp.clip((self.flat + self.ramp - jnp.abs(jnp.asarray(tau))) / self.ramp, 0, 1)

    def discontinuities(self):
        ends = self.flat, self.flat + self.ramp
        return [*ends, *(-x for x in ends)]

    def bounds(self):
        return {"flat": (0.05, 0.5), "ramp": (0.05, 0.45)}


def motion_of(half_exposure):
    return ParabolicMotion(acceleration=ACCELERATION, half_exposure=half_exposure)


def by_slit(kind, half_width):
    """Kernel and transfer function of a slit, or of a shorter exposure that is the same."""
    if kind is RectShutter:
        shutter, motion, share = RectShutter(), motion_of(HALF_EXPOSURE * half_width), half_width
    else:
        shutter, motion, share = kind(half_width), motion_of(HALF_EXPOSURE), 1.0
    taps = blur_kernel(shutter, motion, speed=SPEED, num_taps=NUM_TAPS)
    waves = transfer_function(shutter, motion, speed=SPEED, frequency=FREQUENCIES)
    return jnp.concatenate([taps, waves.real, waves.imag]) * share


@pytest.mark.slow
@pytest.mark.parametrize("half_width", [0.51, 0.7345, 0.05018, 0.5, 1.0, 0.5 + 1e-9, 0.5 - 1e-16])
def test_a_declared_jump_is_exact(half_width):
    """As the shorter exposure that it is, value and slope; also where pieces meet anyway."""
    width = jnp.array(half_width)
    found, exact = (by_slit(kind, width) for kind in (DeclaredSlit, RectShutter))
    np.testing.assert_allclose(found, exact, rtol=0, atol=ROUNDING)
    slopes = [jax.jacfwd(partial(by_slit, kind))(width) for kind in (DeclaredSlit, RectShutter)]
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=0, atol=2e-13)
    taps = [x[:NUM_TAPS] / x[:NUM_TAPS].sum() for x in (found, exact)]
    numbers = [float(condition_number(x, num_frequencies=256)) for x in taps]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-12)


@pytest.mark.parametrize("half_width", [0.51, 0.5, 0.5 + 1e-7, 0.0314, 31 / 32 + 1e-5])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_jump_that_is_not_declared_is_refused(half_width, dtype):
    """Wherever it is: a parameter could move it away from where pieces meet."""
    shutter = Slit(jnp.array(half_width, dtype))
    with pytest.raises(ValueError, match=r"discontinuities\(\)` say .*; got a jump.* tau = -?"):
        blur_kernel(shutter, motion_of(HALF_EXPOSURE), num_taps=4)


def test_a_bend_that_is_not_declared_is_refused():
    """A kink of a continuous profile."""

    class Bent(AbstractShutter):
        def transmittance(self, tau):
            return jnp.clip(1.3 * (1 - jnp.abs(jnp.asarray(tau))), 0, 1)

    with pytest.raises(ValueError, match=r"`Bent.transmittance` must be smooth but .* near tau"):
        Bent().efficiency()


@pytest.mark.parametrize("place", [np.nan, np.inf, np.zeros(2), 0.3j])
def test_discontinuities_are_times(place):
    """Anything else is named."""

    class Strange(AbstractShutter):
        def transmittance(self, tau):
            return jnp.ones_like(jnp.asarray(tau))

        def discontinuities(self):
            return [place]

    with pytest.raises(ValueError, match=r"`Strange.discontinuities\(\)` must be finite numbers"):
        Strange().efficiency()


@pytest.mark.slow
def test_bends_are_exact():
    """A leaf shutter without a flat part, nearly, is a triangle of a shorter exposure."""
    ramp = 0.43
    found = blur_kernel(
        LeafShutter(0.0, ramp), motion_of(HALF_EXPOSURE), speed=SPEED, num_taps=NUM_TAPS
    )
    exact = blur_kernel(
        TriangleShutter(), motion_of(HALF_EXPOSURE * ramp), speed=SPEED, num_taps=NUM_TAPS
    )
    np.testing.assert_allclose(found, ramp * exact, rtol=0, atol=ROUNDING)


@pytest.mark.slow
def test_single_precision_follows():
    """To what float32 holds."""
    motion = ParabolicMotion(
        acceleration=np.float32(ACCELERATION), half_exposure=np.float32(HALF_EXPOSURE)
    )
    found = blur_kernel(DeclaredSlit(np.float32(0.51)), motion, num_taps=NUM_TAPS)
    exact = blur_kernel(DeclaredSlit(0.51), motion_of(HALF_EXPOSURE), num_taps=NUM_TAPS)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, exact, rtol=0, atol=4e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "numbers"),
    [(DeclaredSlit, [0.51]), (LeafShutter, [0.37, 0.29])],
    ids=["jumps", "bends"],
)
def test_one_that_is_known_may_be_closed_over(kind, numbers):
    """In a function that JAX compiles or differentiates it is checked, and is what it is alone."""
    shutter = kind(*map(jnp.asarray, numbers))
    light = float(jnp.asarray(piecewise(shutter).efficiency()))
    assert jax.jit(lambda x: x * shutter.efficiency())(1.7) == pytest.approx(1.7 * light, rel=1e-14)
    assert jax.grad(lambda x: x * shutter.efficiency())(1.7) == pytest.approx(light, rel=1e-14)


def test_coordinates_are_shares_of_the_bounds():
    """And give the shutter back; a shutter without bounds has none."""
    shutter = LeafShutter(0.14, 0.25)
    assert is_adjustable(shutter)
    assert not is_adjustable(Slit(0.3))
    box = coordinates(shutter)
    np.testing.assert_allclose(box, [0.2, 0.5], rtol=1e-14)
    again = at_coordinates(shutter, box)
    assert isinstance(again, LeafShutter)
    np.testing.assert_allclose([again.flat, again.ramp], [0.14, 0.25], rtol=1e-14)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"width": (0, 1)}, r"bounds\(\)\['width'\]` must be of a field"),
        ({"half_width": (1, 0)}, "must be two finite numbers that ascend"),
        ({"half_width": (0, np.inf)}, "must be two finite numbers that ascend"),
    ],
)
def test_wrong_bounds_are_named(bounds, message):
    """Before anything is searched."""

    class Wrong(AbstractShutter):
        half_width: jax.Array

        def transmittance(self, tau):
            return jnp.ones_like(jnp.asarray(tau))

        def bounds(self):
            return bounds

    with pytest.raises(ValueError, match=message):
        optimise(example_scene(), shutter=Wrong(jnp.array(0.3)), max_steps=2)


@final
class SoftShutter(AbstractShutter):
    """Opens and closes along a curve, which a small `ramp` makes too steep to follow."""

    open: jax.Array
    ramp: jax.Array

    def transmittance(self, tau):
        return self.open / (1 + jnp.exp(4 * (jnp.abs(jnp.asarray(tau)) - 0.6) / self.ramp))

    def discontinuities(self):
        return [0.0]

    def bounds(self):
        return {"open": (0.2, 0.9), "ramp": (0.01, 0.5)}


def test_a_range_is_looked_at_before_the_search():
    """At its ends and in its middle; the line names the values at which it is no shutter."""
    ends = re.escape("near tau = 0.6") + r"\d* with open = 0\.\d+, ramp = 0\.01\.$"
    with pytest.raises(ValueError, match=ends):
        optimise(example_scene(), shutter=SoftShutter(jnp.array(0.5), jnp.array(0.3)))


@final
class CrossedShutter(AbstractShutter):
    """Lets more than all light pass where `first` is small and `second` is in its middle."""

    first: jax.Array
    second: jax.Array

    def transmittance(self, tau):
        top = 0.5 + 3.2 * (1 - self.first) * self.second * (1 - self.second)
        return jnp.full_like(jnp.asarray(tau), top)

    def bounds(self):
        return {"first": (0.0, 1.0), "second": (0.0, 1.0)}


def test_each_range_is_looked_at_beside_the_middle_of_the_others():
    """Neither the corners of the ranges nor their middle show it."""
    with pytest.raises(ValueError, match=r"got 1\.3 .*with first = 0, second = 0\.5\.$"):
        optimise(example_scene(), shutter=CrossedShutter(jnp.array(0.5), jnp.array(0.3)))


@pytest.mark.slow
def test_one_with_parameters_is_designed_saved_and_compared(tmp_path):
    """The best slit is a shorter open exposure, so it ends where the best rect does."""
    before = list(kinds.KINDS)
    register_shutter(DeclaredSlit)
    scene = SCENE
    try:
        design = optimise(scene, shutter=DeclaredSlit(jnp.array(0.6)), num_starts=4)
        design.save(tmp_path / "slit.json")
        read = Design.load(tmp_path / "slit.json")
    finally:
        kinds.KINDS[:] = before
    assert isinstance(read.shutter, DeclaredSlit)
    np.testing.assert_array_equal(read.shutter.half_width, design.shutter.half_width)
    table = compare(scene, read)
    own, rect = (table.row(name).metrics.expected_psnr for name in ("optimised", "rect"))
    assert float(own) == pytest.approx(float(rect), abs=0.01)


def test_an_interpolant_has_pieces_for_what_is_declared():
    """64 equal ones, and one more for each time."""
    ends = piecewise(LeafShutter()).breakpoints(np.dtype(np.float64))
    assert ends.size == 64 + 1 + 4
    assert np.all(np.diff(ends) >= 0)


@pytest.mark.parametrize(("off", "moves"), [(1.4e-14, True), (-1.4e-14, True), (1.5e-14, False)])
def test_a_time_that_all_but_coincides_with_a_declared_one_moves_with_it(off, moves):
    """Within 64 roundings, on either side of mid-exposure: else rounding tells where a jump is."""
    place = 0.5 + off
    ends = np.asarray(piecewise(DeclaredSlit(jnp.array(place))).breakpoints(np.dtype(float)))
    for sign in (1, -1):
        assert np.count_nonzero(ends == sign * place) == 1 + moves
        assert np.any(ends == sign * 0.5) == (not moves)
