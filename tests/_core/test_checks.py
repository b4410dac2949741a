"""The checks that every public name shares: what passes, and the one line of what does not."""

import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import (
    ChippedShutter,
    ExpectedErrorLoss,
    HannShutter,
    IdealDevice,
    Limits,
    ParabolicMotion,
    Scene,
    SecondOrderStage,
    StillCamera,
    TukeyShutter,
    blur_kernel,
    compare,
    condition_number,
    deconvolve,
    example_scene,
    optimise,
    simulate_capture,
    starting_shutter,
    sweep,
)
from mishutter._core.checks import (
    as_float,
    common_dtype,
    describe,
    floating_light,
    require_finite,
    require_key,
    require_positive_int,
)
from mishutter.model.motion import simplified
from mishutter.model.shutters.base import piecewise


def test_a_count_is_a_plain_integer():
    """A whole number of NumPy comes back as Python's, which JAX takes for static."""
    assert type(require_positive_int("f(n=...)", np.int64(50))) is int


@pytest.mark.parametrize("count", [0, -3, 2.0, True, "4", np.array([3])])
def test_what_is_no_count(count):
    """Anything but a whole number of at least one is refused by name."""
    with pytest.raises(ValueError, match=r"`f\(n=...\)` must be a positive integer; got"):
        require_positive_int("f(n=...)", count)


def test_keys():
    """No key, and a key of either kind, pass."""
    for key in (None, jax.random.key(3), jax.random.PRNGKey(3)):
        require_key("f(key=...)", key)


def test_what_is_no_key():
    """A seed in place of a key, and several keys, are refused by name."""
    for key in (3, "x", np.zeros(2), jax.random.split(jax.random.key(1), 3)):
        with pytest.raises(ValueError, match=r"`f\(key=...\)` must be one key, .*; got"):
            require_key("f(key=...)", key)


def test_what_is_too_long_is_not_shown():
    """Brackets without end and digits without end are described all the same."""
    deep = []
    for _ in range(100_000):
        deep = [deep]
    assert describe(deep) == "list too long to show"
    assert describe(10**5000) == "int too long to show"


class Tensor:
    """An array of another library: NumPy reads it, and its types are not NumPy's."""

    dtype, shape = "single", (2, 3)

    def __array__(self, dtype=None, copy=None):
        """The numbers, as NumPy asks for them."""
        return np.asarray([[0.1, 0.7, 0.4], [0.9, 0.2, 0.3]], dtype or np.float32)


def test_tensors_of_other_libraries_are_arrays():
    """They are light, and real numbers."""
    light = floating_light(Tensor(), "f(light=...)")
    assert light.dtype == np.float32
    np.testing.assert_array_equal(light, np.asarray(Tensor()))
    inspect.unwrap(require_finite)("f(x=...)", Tensor())


NO_NUMBERS = ["3", None, 1j, [1.0, "2"], [[1.0], [1.0, 2.0]], [3.0, None], {"a": 1.0}]


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_what_is_no_number(value):
    """Text, nothing, complex numbers and ragged rows are refused by name."""
    with pytest.raises(ValueError, match=r"`f\(x=...\)` must be real numbers; got"):
        inspect.unwrap(as_float)(value, "f(x=...)")
    with pytest.raises(ValueError, match=r"`f\(x=...\)` must be real numbers; got"):
        inspect.unwrap(require_finite)("f(x=...)", value)


@pytest.mark.parametrize("value", [3, True, np.float32(2), (1.5, 2.5), [], np.ones((2, 3), int)])
def test_what_is_a_number(value):
    """Of every kind, in rows too."""
    assert np.array_equal(inspect.unwrap(as_float)(value, "f(x=...)"), np.asarray(value, float))


@pytest.mark.parametrize("half", [np.float16, jnp.bfloat16])
def test_half_precision_counts_as_single(half):
    """Which a result is as precise as; beside other numbers the widest decides."""
    assert as_float(half(0.25)).dtype == common_dtype(half(0.25), np.float32(1)) == np.float32
    assert common_dtype(half(0.25), 1.0, np.float64(1)) == np.float64
    motion = ParabolicMotion(acceleration=half(300), half_exposure=half(0.25))
    single = ParabolicMotion(acceleration=np.float32(300), half_exposure=np.float32(0.25))
    kernel = blur_kernel(TukeyShutter(half(0.5)), motion, num_taps=5)
    assert np.array_equal(kernel, blur_kernel(TukeyShutter(np.float32(0.5)), single, num_taps=5))
    assert kernel.dtype == np.float32


@pytest.mark.parametrize("kind", [">f8", np.longdouble, ">i4"])
def test_numbers_of_other_makers_are_plain_ones(kind):
    """In another order of bytes, or longer than double, they are the nearest that JAX has."""
    row = np.array([-300, 25, 410], kind)
    plain = row.astype(float)
    assert np.array_equal(as_float(row), plain)
    assert as_float(row).dtype == common_dtype(row) == np.float64
    scene = Scene(row, photon_rate=row[2], read_noise=row[1])
    assert np.array_equal(scene.speeds, plain)
    motion = ParabolicMotion(acceleration=row[2], half_exposure=0.25)
    assert motion.acceleration == 410.0


@pytest.mark.parametrize("kind", [ParabolicMotion, StillCamera])
def test_motions_are_of_one_number_each(kind):
    """Many are stacked by `jax.vmap`; a row in one of them would meet the taps."""
    others = {"acceleration": 3.0} if kind is ParabolicMotion else {}
    subject = rf"`{kind.__name__}\(half_exposure=...\)` must be a scalar; got shape \(2,\)\."
    with pytest.raises(ValueError, match=subject):
        kind(half_exposure=np.array([0.1, 0.2]), **others)
    stacked = jax.vmap(lambda half: kind(half_exposure=half, **others))(np.ones(4))
    assert stacked.half_exposure.shape == (4,)


def test_a_class_or_nothing_in_the_place_of_a_thing():
    """None is no motion, and a shutter's class is not a shutter."""
    with pytest.raises(ValueError, match="`motion` must be a motion; got None"):
        inspect.unwrap(simplified)(None)
    with pytest.raises(ValueError, match="`shutter` must be a shutter; got <class"):
        inspect.unwrap(piecewise)(HannShutter)
    for call in (optimise, compare):
        subject = rf"`{call.__name__}\(motion=\.\.\.\)` must be a motion; got 'left'"
        with pytest.raises(ValueError, match=subject):
            inspect.unwrap(call)(example_scene(), "left")


def test_an_error_is_one_line():
    """Also where what came is shown in several."""
    assert "\n" not in describe(Limits())


def test_a_motion_shows_its_numbers():
    """Printed, or as what came in an error, traced or not."""
    motion = ParabolicMotion(acceleration=4.5e5, half_exposure=0.01)
    assert repr(motion) == (
        "ParabolicMotion(acceleration=450000.0, half_exposure=0.01, velocity=0.0)"
    )
    assert describe(StillCamera(half_exposure=0.25)) == (
        "ParabolicMotion(acceleration=0.0, half_exposure=0.25, velocity=0.0)"
    )
    shown = []
    jax.jit(lambda m: shown.append(repr(m)))(motion)
    assert shown[0].startswith("ParabolicMotion(acceleration=")


@pytest.mark.parametrize(
    ("thing", "text"),
    [
        (
            Limits(max_stroke=38.5, max_top_speed=4800.0, max_half_exposure=0.04, max_pan=0.0),
            "Limits(max_stroke=38.5, max_top_speed=4800, min_half_exposure=0.0001, "
            "max_half_exposure=0.04, max_pan=0, pans='stage', axes='each')",
        ),
        (IdealDevice(transmission=0.4), "IdealDevice(transmission=0.4, leakage=0)"),
        (TukeyShutter(0.35), "TukeyShutter(taper=0.35)"),
        (ChippedShutter([0.25, 1.0, 0.5]), "ChippedShutter(transmittances=3 from 0.25 to 1)"),
        (SecondOrderStage(bandwidth=40.0), "SecondOrderStage(bandwidth=40, damping=0.7)"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_parts_of_a_camera_show_their_numbers(thing, text):
    """In one line, without what they do not limit or have."""
    assert repr(thing) == str(thing) == text


def test_a_shutter_that_is_traced_shows_its_type():
    """A print within `jax.jit` is what users look for errors with."""
    texts = []
    jax.jit(lambda taper: texts.append(str(TukeyShutter(taper))))(0.35)
    assert re.fullmatch(r"TukeyShutter\(taper=.*Tracer.*float64.*\)", texts[0])


def _scene(photon_rate=3e4, speed=310.0):
    speeds = np.array([-1.0, 0.0, 1.0]) * speed
    return Scene(speeds, photon_rate=photon_rate, read_noise=3.0)


def _motion(share=1.0):
    return ParabolicMotion(acceleration=share * 1.1e5, half_exposure=5e-3)


WINDOW, LOSS, LIGHT = TukeyShutter(0.43), ExpectedErrorLoss(), np.full((7, 60), 0.4)
ASKED = {
    "optimise(scene=": lambda x: optimise(_scene(x * 3e4), _motion(), WINDOW, loss=LOSS),
    "optimise(motion=": lambda x: optimise(_scene(), _motion(x), WINDOW, loss=LOSS),
    "optimise(shutter=": lambda x: optimise(_scene(), _motion(), TukeyShutter(x / 2), loss=LOSS),
    "starting_shutter(scene=": lambda x: starting_shutter(_scene(speed=x)),
    "compare(scene=": lambda x: compare(_scene(x * 3e4), _motion(), WINDOW),
    "compare(motion=": lambda x: compare(_scene(), _motion(x), WINDOW),
    "simulate_capture(motion=": lambda x: simulate_capture(LIGHT, _scene(), _motion(x), WINDOW),
    "blur_model(scene=": lambda x: deconvolve(LIGHT, _scene(x * 3e4), _motion(), WINDOW),
    "sweep(scenes=": lambda x: sweep(
        _scene(x * 3e4), accelerations=[1e4, 2e4], half_exposures=[5e-3]
    ),
}
"""What decides how much is computed, by the name in the error, as a function of a number."""


@pytest.mark.parametrize("name", ASKED)
@pytest.mark.parametrize("transform", [jax.jit, jax.grad])
def test_what_decides_a_computation_is_known(name, transform):
    """Within a function that JAX transforms it is named, in one line."""
    with pytest.raises(
        ValueError, match=rf"{re.escape(name)}.*must hold concrete numbers; got ones"
    ):
        transform(ASKED[name])(1.0)


def test_what_has_no_numbers_to_show_is_named():
    """A traced array and a random key have none: an error names their kind, and is the house's."""

    def traced(kernel):
        with pytest.raises(ValueError, match=r"be real numbers; got complex128 of shape \(3,\)"):
            condition_number(kernel)
        return kernel

    jax.jit(traced)(np.array([0.3, 0.5j, 0.2]))
    assert describe(jax.random.key(3)) == "key<fry> of shape ()"
