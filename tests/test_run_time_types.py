"""Annotations of the package are checked in these tests, and loops are not slowed by that."""

import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float
from support.run_time_types import MOST_CALLS

from mishutter import HannShutter, Limits, ParabolicMotion, blur_kernel
from mishutter.camera.responses import frequencies_on

MOTION = ParabolicMotion(acceleration=1.3e5, half_exposure=0.0117)


WRONG = {
    "an argument": lambda: blur_kernel(HannShutter(), MOTION, speed="fast", num_taps=33),
    "one of its own": lambda: frequencies_on(np.ones(3)),
    "a field": lambda: Limits(max_half_exposure=0.01, pans=3),
}


@pytest.mark.parametrize("slug", WRONG)
def test_a_wrong_type_is_refused(slug):
    """Of a public function, of one that only the package calls, and of a class."""
    with pytest.raises(jaxtyping.TypeCheckError, match="checking the parameters"):
        WRONG[slug]()


def test_a_function_is_checked_at_its_first_calls_of_a_test():
    """A loop goes on without; a function within a function is what it was."""

    def beartyped(function):
        from beartype import beartype

        return beartype(function)

    def inner(x: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return x

    hooked = jaxtyping.jaxtyped(typechecker=beartyped)
    assert hooked(inner) is inner
    inner.__qualname__ = "outer"
    outer = hooked(inner)
    for _ in range(MOST_CALLS - 1):
        outer(np.ones(3))
    with pytest.raises(jaxtyping.TypeCheckError):
        outer(3)
    assert outer(3) == 3
