"""A constructor answers an argument that it does not have with its own name and the nearest."""

import copy
import inspect
import pickle
import re

import equinox as eqx
import pytest

import mishutter
from mishutter import (
    HannShutter,
    Limits,
    ParabolicMotion,
    Scene,
    example_scene,
)

LIGHT = {"photon_rate": 1.3e4, "read_noise": 2.3}
UNKNOWN = {
    "`Scene.uniform` has no argument `photons`; did you mean `photon_rate`?": lambda: Scene.uniform(
        max_speed=930.0, photons=1.3e4, read_noise=2.3
    ),
    "`Scene.uniform` has no argument `max_sped`; did you mean `max_speed`?": lambda: Scene.uniform(
        max_speed=930.0, max_sped=3.0, **LIGHT
    ),
    "`Scene.uniform` has no argument `speeds`; did you mean": lambda: Scene.uniform(
        max_speed=930.0, speeds=[3.0], **LIGHT
    ),
    "`Scene` has no argument `readnoise`; did you mean `read_noise`?": lambda: Scene(
        [930.0], readnoise=2.3, photon_rate=1.3e4
    ),
    "`Limits` has no argument `stroke`; did you mean `max_stroke`?": lambda: Limits(stroke=37.0),
    "`ParabolicMotion` has no argument `a`; it takes acceleration, half_exposure, velocity.": (
        lambda: ParabolicMotion(a=1.3e5, half_exposure=0.01)
    ),
    "`HannShutter` has no argument `taper`; it takes none.": lambda: HannShutter(taper=0.3),
}


@pytest.mark.parametrize("message", UNKNOWN)
def test_an_unknown_argument_is_answered_with_the_nearest(message):
    """One line names the constructor that was called, and what it takes."""
    with pytest.raises(TypeError, match=re.escape(message)):
        UNKNOWN[message]()


MODULES = sorted(
    name
    for name in dir(mishutter)
    if inspect.isclass(kind := getattr(mishutter, name))
    and issubclass(kind, eqx.Module)
    and not inspect.isabstract(kind)
    and name not in ("Metrics", "BlurModel")  # which only the package makes
)


@pytest.mark.parametrize("name", MODULES)
def test_every_public_module_answers_so(name):
    """A class that is added takes part, and its signature stays what `help` shows."""
    kind = getattr(mishutter, name)
    told = f"`{kind.__name__}` has no argument `nothing_like_it`"  # Some have a name of before
    with pytest.raises(TypeError, match=re.escape(told)):
        kind(nothing_like_it=3)
    assert all(
        each.kind is not each.VAR_KEYWORD for each in inspect.signature(kind).parameters.values()
    )


def test_modules_are_copied_and_pickled_as_before():
    """Neither goes by the constructor's arguments."""
    scene = example_scene()
    for other in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        assert eqx.tree_equal(other, scene)
