"""Losses over their whole domain, driven by hypothesis: finite with a slope, or refused by name.

`CORPUS` holds every case that ever failed; a new one is added before it is mended.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import mishutter as ms
from mishutter.search.solvers import NonFiniteLossError

CODE = np.array([0.0, 1.0, 0.3, 1.0, 0.0, 0.7])
PROFILES = {
    "chips": (ms.ChippedShutter, CODE),
    "closed": (ms.ChippedShutter, np.zeros(6)),
    "one chip": (ms.ChippedShutter, np.eye(6)[2]),
    "spline": (ms.SplineShutter, 0.5 + 0.5 * np.sin(2.1 * np.arange(9))),
    "open spline": (ms.SplineShutter, np.ones(9)),
    "Tukey": (ms.TukeyShutter, np.array(0.4)),
    "short Tukey": (ms.TukeyShutter, np.array(0.02)),
    "Gaussian": (ms.GaussianShutter, np.array(0.3)),
}
LOSSES = {
    "design": ms.DesignLoss(condition=1.0, invariance=1.0, efficiency=0.5),
    "expected error": ms.ExpectedErrorLoss(),
    "both": 0.5 * ms.DesignLoss(condition=1.0, invariance=1.0, efficiency=0.5)
    + 2.0 * ms.ExpectedErrorLoss(),
}
EVEN = (0.25, 0.25, 0.25, 0.25)


def case(profile="spline", loss="design", speeds=(0.0, 0.3, 0.6, 0.9), weights=EVEN, **others):
    """A case of the corpus; speeds in units of the sensor's top speed, stroke in px."""
    numbers = {"stroke": 30.0, "half_exposure": 0.02, "rate": 1e5, "noise": 4.0, "single": False}
    return dict(profile=profile, loss=loss, speeds=speeds, weights=weights) | numbers | others


CORPUS = {
    "an object at rest among the speeds": case(),
    "the picture's only speed, four times": case(speeds=(0.5,) * 4),
    "speeds that never occur": case(weights=(0.0, 0.0, 1.0, 0.0)),
    "an object a thousand times as fast": case(speeds=(0.0, 1e3, -1e3, 1.0)),
    "an exact zero of the spectrum": case("one chip", stroke=0.0, speeds=(0.0, 1.0, 2.0, 3.0)),
    "a closed shutter": case("closed"),
    "a closed shutter, expected error": case("closed", "expected error"),
    "no light": case(loss="expected error", rate=0.0),
    "no light and no noise": case(loss="expected error", rate=0.0, noise=0.0),
    "no noise": case(loss="both", rate=1e12, noise=0.0),
    "a short taper on a long stroke": case("short Tukey", "expected error", stroke=400.0),
    "a taper in single precision": case("short Tukey", "both", single=True),
    "no stroke": case(loss="both", stroke=0.0),
    "a stroke too short to square": case(loss="both", stroke=1e-180),
    "no stroke and a long exposure": case(
        "Gaussian", "both", speeds=(0.0,) * 4, stroke=0.0, half_exposure=10.0
    ),
    "a speed as fast as the sensor": case("Tukey", "both", speeds=(0.0, 1.0, -1.0, 0.5)),
    "ranges that mirror but for rounding": case(speeds=(-0.9, -0.3, 0.3, 0.9000000000000001)),
}


def value_and_slope(profile, loss, speeds, weights, stroke, half_exposure, rate, noise, single):
    """Loss of a design and its slope by profile, acceleration and exposure."""
    kind, parameters = PROFILES[profile]
    dtype = np.float32 if single else np.float64
    acceleration = stroke / half_exposure**2
    top = 2 * acceleration * half_exposure if stroke else 1 / half_exposure
    share = np.asarray(weights) / np.sum(weights)
    scene = ms.Scene(
        np.asarray(speeds, dtype) * dtype(top),
        share.astype(dtype),
        photon_rate=dtype(rate),
        read_noise=dtype(noise),
    )

    def total(parameters, acceleration, half_exposure):
        motion = ms.ParabolicMotion(acceleration=acceleration, half_exposure=half_exposure)
        return LOSSES[loss](scene, motion, kind(parameters))

    at = [jnp.asarray(x, dtype) for x in (parameters, acceleration, half_exposure)]
    return jax.value_and_grad(total, argnums=(0, 1, 2))(*at)


def holds(given_case) -> None:
    """The loss and its slope are finite, or an error says what is wrong in one line."""
    value = slope = refusal = None
    try:
        value, slope = value_and_slope(**given_case)
    except (ValueError, NonFiniteLossError) as error:
        refusal = str(error)
    if refusal:
        assert "must" in refusal
        assert "\n" not in refusal
        return
    assert bool(jnp.isfinite(value)), given_case
    assert all(bool(jnp.all(jnp.isfinite(part))) for part in slope), given_case


@pytest.mark.slow
@pytest.mark.parametrize("name", CORPUS)
def test_cases_that_failed_once(name):
    """Each is finite now, or refused by name."""
    holds(CORPUS[name])


speeds = st.tuples(*[st.sampled_from([0.0, 1e-9, 0.2, -0.2, 0.7, 1.0, -1.0, 3.0, 1e3])] * 4)
weights = st.tuples(*[st.sampled_from([0.0, 1e-12, 0.5, 1.0])] * 4).filter(lambda w: sum(w) > 0)
cases = st.fixed_dictionaries(
    {
        "profile": st.sampled_from(sorted(PROFILES)),
        "loss": st.sampled_from(sorted(LOSSES)),
        "speeds": speeds,
        "weights": weights,
        "stroke": st.one_of(st.just(0.0), st.floats(-12, 2.5).map(lambda x: 10**x)),
        "half_exposure": st.floats(-9, 5).map(lambda x: 10**x),
        "rate": st.one_of(st.just(0.0), st.floats(-3, 12).map(lambda x: 10**x)),
        "noise": st.one_of(st.just(0.0), st.floats(-6, 4).map(lambda x: 10**x)),
        "single": st.booleans(),
    }
)


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(cases)
@example(CORPUS["a short taper on a long stroke"])
def test_losses_are_finite_wherever_they_are_asked_for(chosen):
    """Any scene, motion, profile and precision of the domain."""
    holds(chosen)
