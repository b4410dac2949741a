"""Errors of measured numbers: their ranges, and the section of a file that holds them."""

import numpy as np
import pytest

from mishutter import MeasurementErrors, Scene, example_scene


@pytest.mark.parametrize("name", ["photon_rate", "read_noise", "speed", "front_share"])
def test_an_error_is_a_number_of_at_least_0(name):
    """The line names the argument."""
    with pytest.raises(ValueError, match=rf"MeasurementErrors\({name}=...\)` must be at least 0"):
        MeasurementErrors(**{name: -1.0})
    with pytest.raises(ValueError, match=rf"MeasurementErrors\({name}=...\)"):
        MeasurementErrors(**{name: np.array([1.0, 2.0])})


def test_integrals_do_not_see_errors():
    """A scene without its errors is the same to them."""
    assert example_scene().errors is None
    errors = MeasurementErrors(read_noise=0.2)
    assert (
        Scene([100.0], photon_rate=1e5, read_noise=2.0, errors=errors).without_metadata().errors
        is None
    )
