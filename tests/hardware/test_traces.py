"""Profiles that photodiodes' traces show: noise, levels, an inverted diode and a clipped one.

Bounds are three to six standard deviations of what the noise of the samples allows.
"""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION
from support.exports import pulse

from mishutter import HannShutter, measured_profile
from mishutter.hardware.traces import Trace, for_a_fit

HALF = float(MOTION.half_exposure)
TAU = np.linspace(-1, 1, 401)
HANN = np.cos(np.pi * TAU / 2) ** 2


def noisy_trace(noise, seed=3):
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(-1.3, 1.3, 3000)) * HALF
    level = 0.21 + 1.7 * np.asarray(HannShutter().transmittance(time / HALF))
    return Trace(time + 2e-3, level + 1.7 * noise * rng.standard_normal(time.size))


def test_a_noisy_trace_of_unequal_steps_is_the_shutter():
    """Levels, noise and profile of a Hann shutter are found within what the noise allows."""
    found = measured_profile(noisy_trace(0.05), half_exposure=HALF, middle=2e-3)
    assert found.noise == pytest.approx(0.05, rel=0.06)
    assert found.closed == pytest.approx(0.21, abs=5 * 1.7 * 0.05 / np.sqrt(690))
    assert found.opened == pytest.approx(1.91, abs=0.08)
    tau = np.linspace(-1, 1, 401)
    error = np.asarray(found.shutter.transmittance(tau)) - np.asarray(
        HannShutter().transmittance(tau)
    )
    assert np.sqrt(np.mean(error**2)) < 0.02


def test_levels_that_are_given_are_taken():
    """A half-open shutter is half open where the level of the open one is known."""
    trace = noisy_trace(1e-3)
    levels = {"closed": 0.21, "opened": 0.21 + 2 * 1.7}
    found = measured_profile(trace, half_exposure=HALF, middle=2e-3, **levels)
    assert (found.closed, found.opened) == pytest.approx((0.21, 3.61))
    assert float(np.max(found.shutter.transmittance(np.linspace(-1, 1, 99)))) == pytest.approx(
        0.5, abs=2e-3
    )


def test_fine_detail_takes_more_coefficients():
    """Cross-validation finds as many as the profile needs, and no more for a smooth one."""
    smooth = measured_profile(noisy_trace(0.05), half_exposure=HALF, middle=2e-3)
    time = np.linspace(-1.2, 1.2, 2400) * HALF
    wave = 0.5 + 0.45 * np.sin(40 * time / HALF)
    wave = np.where(np.abs(time) <= HALF, wave, 0.0)
    wavy = measured_profile(Trace(time, wave), half_exposure=HALF, opened=1.0)
    assert smooth.shutter.num_coefficients <= 16
    assert wavy.shutter.num_coefficients >= 96
    tau = np.linspace(-1, 1, 333)
    fitted = np.asarray(wavy.shutter.transmittance(tau))
    np.testing.assert_allclose(fitted, 0.5 + 0.45 * np.sin(40 * tau), atol=2e-3)


def of_levels(closed, opened, noise=0.01, count=3000, shift=0.0, reach=1.3):
    """A trace of a Hann shutter, from a photodiode of two levels."""
    rng = np.random.default_rng(11)
    time = np.linspace(-reach, reach, count) * HALF
    light = np.asarray(HannShutter().transmittance(time / HALF - shift))
    return Trace(time, closed + (opened - closed) * (light + noise * rng.standard_normal(count)))


@pytest.mark.parametrize(("closed", "opened"), [(1.25, 0.0), (-0.05, -1.25)])
@pytest.mark.parametrize("known", [True, False])
def test_an_inverted_photodiode_shows_the_same_shutter(closed, opened, known):
    """Levels that fall where the shutter opens give its profile, told or found, and a note."""
    told = {"closed": closed, "opened": opened} if known else {}
    found = measured_profile(of_levels(closed, opened), half_exposure=HALF, **told)
    assert found.closed == pytest.approx(closed, abs=0.003)
    assert found.opened == pytest.approx(opened, abs=0.02)
    assert found.noise == pytest.approx(0.01, rel=0.06)
    error = np.asarray(found.shutter.transmittance(TAU)) - HANN
    assert np.sqrt(np.mean(error**2)) < 0.006
    assert ["inverted" in note for note in found.notes] == [True] * (not known)


def test_a_fall_below_a_told_level_is_inverted():
    """Without a level of the open shutter, of which no steady level of the closed one is asked."""
    found = measured_profile(of_levels(1.25, 0.05), half_exposure=HALF, closed=1.25)
    assert found.opened == pytest.approx(0.05, abs=0.02)
    assert ["inverted" in note for note in found.notes] == [True]


def test_a_trace_reaches_over_its_exposure_without_a_gap():
    """To within an eighth of it at either end, in 32 samples, none a sixteenth apart."""
    given = {"half_exposure": HALF, "closed": 0.0, "opened": 1.0, "middle": 3e-3}

    def found(tau):
        level = np.cos(np.pi * np.clip(tau, -1, 1) / 2) ** 2
        return measured_profile(Trace(tau * HALF + 3e-3, level), **given)

    tau = np.linspace(-1, 1, 200)
    for first, last in ((-0.88, 1.0), (-1.0, 0.88)):
        found(np.linspace(first, last, 200))
    for first, last in ((-0.87, 1.0), (-1.0, 0.87)):
        with pytest.raises(ValueError, match=r"reach over the exposure, -7 to 13 ms by its clock"):
            found(np.linspace(first, last, 200))
    found(tau[(tau < 0.2) | (tau > 0.31)])
    with pytest.raises(ValueError, match=r"have no gap above 1/16 .*; got one of 1\.\d+ ms"):
        found(tau[(tau < 0.2) | (tau > 0.34)])
    found(np.linspace(-0.99, 0.99, 32))
    with pytest.raises(ValueError, match=r"have at least 32 samples within .*; got 31 of times"):
        found(np.linspace(-0.99, 0.99, 31))


def test_a_pulse_outside_the_exposure_is_not_taken_as_inverted():
    """Where light falls before or after the exposure, its dark is no open shutter."""
    for shift in (-2.2, 2.6):
        trace = of_levels(0.2, 1.4, shift=shift, reach=4.1)
        with pytest.raises(ValueError, match="fall there from a steady level, or be read with the"):
            measured_profile(trace, half_exposure=HALF)


@pytest.mark.parametrize(("low", "high"), [(-9, 0.9), (0.06, 9)])
@pytest.mark.parametrize("step", [0, 1e-3, 0.004])
def test_a_clipped_trace_is_said(low, high, step):
    """Samples at one extreme level for long, in noise: of a fine converter or one of 8 bits."""
    _, level = pulse(3000)
    level = np.round(level / step) * step if step else level
    time = np.linspace(-1.25, 1.25, level.size) * HALF
    whole, cut = (
        measured_profile(Trace(time, each), half_exposure=HALF)
        for each in (level, np.clip(level, low, high))
    )
    (note,) = cut.notes
    assert f"at exactly {high if low < 0 else low:g}: what went" in note
    assert whole.notes == ()


@pytest.mark.parametrize(("low", "high"), [(0.3, 0.9), (0.6, 0.8), (0.45, 9), (-9, 0.1)])
@pytest.mark.parametrize("step", [0, 0.004])
def test_a_trace_that_lies_at_its_rails_for_the_most_part_is_said(low, high, step):
    """The noise of the samples between the rails shows it, however few these are."""
    _, level = pulse(900)
    level = np.round(level / step) * step if step else level
    time = np.linspace(-1.25, 1.25, level.size) * HALF
    cut = np.clip(level, low, high)
    assert np.mean((cut == low) | (cut == high)) > 0.5
    notes = measured_profile(Trace(time, cut), half_exposure=HALF).notes
    said = [f"{rail:g}: what went {word}" for word, rail in (("above", high), ("below", low))]
    assert [words in " ".join(notes) for words in said] == [high < 9, low > -9]
    assert len(notes) == (high < 9) + (low > -9)


@pytest.mark.parametrize("step", [1 / 256, 0.013, 1e-6])
def test_ramps_between_rests_are_not_taken_for_noise(step):
    """Rounding to a converter's steps is no noise: rests at both ends are the shutter's own."""
    time = np.linspace(-1.3, 1.3, 700) * HALF
    light = np.clip(2.2 * (1 - np.abs(time) / HALF), 0, 1)
    level = np.round((0.3 + 1.4 * light) / step) * step
    assert measured_profile(Trace(time, level), half_exposure=HALF).notes == ()


LISTS = {
    "one-a-change": ([-19, -12, 3, 14], [0, 1, 0, 1]),
    "one-pulse": ([-12, 14], [3.3, 0]),
    "both-levels-a-change": ([-19, -12, -12, 14, 14, 19], [0, 0, 5, 5, 0, 0]),
    "many": (np.linspace(-23, 23, 322) + 0.03 * np.sin(np.arange(322)), np.arange(322) % 2),
}
"""Times, ms, and levels of lists of transitions."""


@pytest.mark.parametrize("slug", LISTS)
def test_a_list_of_transitions_is_refused_by_name(slug):
    """Lines that all stand at a change are no samples: a spline through them is no profile."""
    time, level = (np.asarray(numbers, float) for numbers in LISTS[slug])
    got = f"got a list of transitions, {time.size} lines"
    with pytest.raises(ValueError, match=f"must hold samples, .*; {got}"):
        measured_profile(Trace(time * 1e-3, level), half_exposure=HALF)


def test_samples_of_two_levels_are_a_trace():
    """A digital channel is read; rests of three samples are too fast for a spline, and no list."""
    time = np.linspace(-1.3, 1.3, 1041) * HALF

    def found(width):
        level = 0.2 + 3.1 * ((np.arange(time.size) // width) % 2)
        return measured_profile(Trace(time, level), half_exposure=HALF, closed=0.2, opened=3.3)

    assert float(found(200).shutter.efficiency()) == pytest.approx(0.5, abs=0.02)
    with pytest.raises(ValueError, match="tell the open shutter from the closed one by more than"):
        found(3)


@pytest.mark.parametrize("step", [0.05, 0.01, 1e-9])
def test_a_shutter_that_stays_open_is_not_clipped(step):
    """A plateau of few levels of a coarse converter, or of no noise, is a shutter's own."""
    rng = np.random.default_rng(2)
    time = np.linspace(-1.3, 1.3, 4000) * HALF
    light = (np.abs(time) < 0.7 * HALF) + (0.004 if step > 1e-6 else 0) * rng.standard_normal(4000)
    found = measured_profile(Trace(time, np.round(light / step) * step), half_exposure=HALF)
    assert found.notes == ()


def test_an_open_level_that_is_the_closed_one_is_refused():
    """Told levels need a difference, as those that are found do."""
    with pytest.raises(ValueError, match="tell the open shutter from the closed one by more than"):
        measured_profile(of_levels(0.2, 1.4), half_exposure=HALF, closed=0.7, opened=0.7)


def test_levels_of_the_wrong_order_are_said():
    """They make a shutter that rests open, which there is; a note says so."""
    found = measured_profile(of_levels(0.2, 1.4), half_exposure=HALF, closed=1.4, opened=0.2)
    assert found.notes == ("by these levels the shutter is open outside the exposure, by 1.00",)
    error = 1 - np.asarray(found.shutter.transmittance(TAU)) - HANN
    assert np.sqrt(np.mean(error**2)) < 0.006


@pytest.mark.slow
def test_a_million_samples_are_the_shutter():
    """As many samples as an oscilloscope has fit in its noise, over the root of their number."""
    found = measured_profile(of_levels(0.1, 1.3, noise=0.3, count=1_000_000), half_exposure=HALF)
    error = np.asarray(found.shutter.transmittance(TAU)) - HANN
    assert np.sqrt(np.mean(error**2)) < 0.004
    assert found.noise == pytest.approx(0.3, rel=0.01)


def test_the_dense_problem_of_least_squares_has_the_same_answer():
    """Normal equations of the samples give the coefficients of the whole basis of B-splines."""
    from scipy.interpolate import BSpline
    from scipy.optimize import lsq_linear

    trace = noisy_trace(0.03)
    found = measured_profile(trace, half_exposure=HALF, middle=2e-3)
    count = found.shutter.num_coefficients
    tau = (trace.time - 2e-3) / HALF
    inside = np.abs(tau) <= 1
    knots = np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])
    basis = BSpline.design_matrix(tau[inside], knots, 3).toarray()
    light = (trace.level[inside] - found.closed) / (found.opened - found.closed)
    wanted = lsq_linear(basis, light, bounds=(0, 1), tol=1e-14).x
    np.testing.assert_allclose(found.shutter.coefficients, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_fit_takes_few_samples_with_light_upwards(sign):
    """Means of neighbours keep level and profile, and none reaches over an end of the exposure."""
    rng, tau = np.random.default_rng(6), np.linspace(-1.3, 1.3, 40_001)

    def light(tau):
        return np.where(np.abs(tau) <= 1, 0.55 + 0.25 * tau, 0)

    level = 0.3 + 1.4 * (light(tau) + 0.01 * rng.standard_normal(tau.size))
    few, notes = for_a_fit(Trace(tau * HALF, sign * level), HALF, "trace.csv")
    assert 4000 < few.time.size < 4200
    assert ["inverted" in note for note in notes] == [True] * (sign < 0)
    error = (few.level - 0.3) / 1.4 - light(few.time / HALF)
    assert np.max(np.abs(error)) < 5 * 0.01 / np.sqrt(10)


def test_a_trace_is_any_two_rows():
    """A pair of lists or arrays of any kind of number is the trace that it holds."""
    trace = noisy_trace(0.02)
    time, level = trace.time[::9], trace.level[::9]
    given = {"half_exposure": HALF, "middle": 2e-3}
    right = measured_profile(Trace(time, level), **given)
    for rows in (
        (time, level),
        [time, level],
        Trace(list(time), list(level)),
        np.stack([time, level]),
        jnp.stack([time, level]),
        (jnp.asarray(time), tuple(level)),
    ):
        found = measured_profile(rows, **given)
        assert found[1:] == right[1:]
        assert np.array_equal(found.shutter.coefficients, right.shutter.coefficients)


@pytest.mark.parametrize(
    ("trace", "line"),
    [
        (3.2, "be a `Trace`, or times and levels; got 3.2"),
        (np.array(3.2), "be a `Trace`, or times and levels; got 3.2"),
        ((TAU, TAU, TAU), "be a `Trace`, or times and levels; got"),
        (np.stack([TAU, 1j * TAU]), "be real numbers; got"),
        ((TAU, TAU[1:]), "as many levels; got shapes (401,) and (400,)"),
        ((TAU[None], TAU[None]), "as many levels; got shapes (1, 401) and (1, 401)"),
        (Trace([0.1, 0.3], [0.2, float("nan")]), "be finite; got"),
    ],
)
def test_what_is_no_trace(trace, line):
    """It is refused as other arguments are, by a fit too."""
    said = re.escape("`measured_profile(trace=...)` must ") + ".*" + re.escape(line)
    with pytest.raises(ValueError, match=said):
        measured_profile(trace, half_exposure=HALF)
    with pytest.raises(ValueError, match=re.escape(line)):
        for_a_fit(trace, HALF, "fit(trace=...)")


@pytest.mark.parametrize(
    ("numbers", "line"),
    [
        ({"half_exposure": -HALF}, f"half_exposure=...)` must be above 0 s; got {-HALF}."),
        ({"closed": float("nan")}, "closed=...)` must be finite; got nan."),
        ({"opened": float("inf")}, "opened=...)` must be finite; got inf."),
        ({"middle": float("nan")}, "middle=...)` must be finite; got nan."),
    ],
)
def test_numbers_that_no_trace_can_have_are_refused_by_name(numbers, line):
    """An exposure lasts for a while, and levels and times are numbers."""
    with pytest.raises(ValueError, match=re.escape(f"`measured_profile({line}")):
        measured_profile(noisy_trace(0.02), **{"half_exposure": HALF} | numbers)
