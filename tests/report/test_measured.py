"""A measured shutter beside its design: the loss in words, and the shift that gives it back."""

import numpy as np
import pytest
from support.designs import MOTION, SCENE

from mishutter import HannShutter, SplineShutter, evaluate, measured_profile
from mishutter.design.design import given_design
from mishutter.hardware.traces import Trace
from mishutter.model.exposures import Exposures
from mishutter.report.measured import MeasuredCamera, measured_camera
from mishutter.search.rows import OWN_BEST_MOTION, Row

HALF = float(MOTION.half_exposure)
LATE = 1.3e-3
PROFILE = SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4])


def trace_of(late):
    """A trace that begins and ends 3 ms outside the exposure, of a shutter sent late."""
    time = np.linspace(-HALF - 3e-3, HALF + 3e-3, 2001)
    return Trace(time, 0.1 + 2.0 * np.asarray(PROFILE.transmittance((time - late) / HALF)))


def measured(late):
    trace = trace_of(late)
    profile = measured_profile(trace, half_exposure=HALF, closed=0.1, opened=2.1)
    camera = given_design(SCENE, MOTION, profile.shutter, "Measured.", is_measured=True)
    rows = {
        name: Row(
            OWN_BEST_MOTION,
            name,
            Exposures.of_one(MOTION, shutter),
            None,
            evaluate(SCENE, MOTION, shutter),
        )
        for name, shutter in (("designed", PROFILE), ("measured", camera.shutter))
    }
    names = {"measured": "measured", "designed": "designed"}
    return measured_camera(SCENE, rows, trace, profile, middle=0.0, **names)


@pytest.mark.slow
def test_a_late_shutter_is_to_be_sent_earlier():
    """At the shift that is found a fit of the trace has the level that is told, and no less."""
    found = measured(LATE)
    assert found.shifted_level >= found.level
    again = measured_profile(
        trace_of(LATE), half_exposure=HALF, middle=found.earlier, closed=0.1, opened=2.1
    )
    level = float(evaluate(SCENE, MOTION, again.shutter).expected_psnr)
    assert level == pytest.approx(found.shifted_level, abs=1e-6)
    for middle in np.linspace(-3e-3, 3e-3, 5):
        other = measured_profile(
            trace_of(LATE), half_exposure=HALF, middle=middle, closed=0.1, opened=2.1
        )
        level = float(evaluate(SCENE, MOTION, other.shutter).expected_psnr)
        assert level <= found.shifted_level + 2e-3
    assert found.to_dict()["best_sent_earlier_ms"] == found.earlier * 1e3


def test_sentences_on_a_measured_shutter():
    """The loss is against the design, and a shift that gives nothing is not named."""
    assert MeasuredCamera(26.382, 26.581, 9.67e-4, 26.563).lines() == [
        "As measured: 26.38 dB, 0.20 dB below the design.",
        "Sent 0.97 ms earlier it has 26.56 dB, 0.02 dB below the design.",
    ]
    assert MeasuredCamera(26.6, 26.581, -2e-4, 26.603).lines() == [
        "As measured: 26.60 dB, 0.02 dB above the design.",
        "No shift in time against the stage gives more.",
    ]
    assert MeasuredCamera(26.38, None, -2e-3, 26.5).lines() == [
        "As measured: 26.38 dB.",
        "Sent 2 ms later it has 26.50 dB.",
    ]


def test_shifts_end_where_the_trace_does():
    """They end at a gap too, and at a quarter of the exposure."""
    time = np.linspace(-HALF - 3e-3, HALF + 9e-3, 2001)
    level = np.asarray(HannShutter().transmittance(time / HALF))
    assert Trace(time, level).span_of_shifts(HALF, 0.0) == pytest.approx((-3e-3, HALF / 2))
    whole = (time < HALF + 1e-3) | (time > HALF + 4e-3)
    span = Trace(time[whole], level[whole]).span_of_shifts(HALF, 0.0)
    assert span == pytest.approx((-3e-3, 1e-3), abs=2e-5)
    inside = np.abs(time) < HALF
    assert Trace(time[inside], level[inside]).span_of_shifts(HALF, 0.0) == (0.0, 0.0)
