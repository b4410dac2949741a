"""Devices: the transmittance that light sees, by its own formula at every level."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from support.cases import DEVICES, SHUTTERS
from support.classes import final_classes
from support.plan_check import metrics_by

import mishutter
from mishutter import (
    AbstractShutter,
    ChippedShutter,
    FirstOrderDevice,
    HannShutter,
    IdealDevice,
    ParabolicMotion,
    RectShutter,
    Scene,
    Sensor,
    SplineShutter,
    StillCamera,
    SwitchedDevice,
    TriangleShutter,
    TukeyShutter,
    blur_kernel,
    evaluate,
    simulate_capture,
    transfer_function,
)
from mishutter.decoding.decoders.base import blur_model
from mishutter.model import devices
from mishutter.model.devices import AbstractDevice, command_of
from mishutter.model.slots import diffused, runs_are_long_enough, slot_means

T, LEAKAGE = 0.83, 0.07
DEVICE = IdealDevice(transmission=T, leakage=LEAKAGE)
LIGHT = {"photon_rate": 1e5, "read_noise": 5.0}
SCENE = Scene([-700.0, 0.0, 900.0], **LIGHT, device=DEVICE)
MOTION = ParabolicMotion(acceleration=2e5, half_exposure=8e-3)
TAU = np.linspace(-1.2, 1.2, 241)


def _light(shutter):
    return DEVICE.light(shutter, 1e-2, np.dtype(float))


@pytest.mark.parametrize("slug", [slug for slug in SHUTTERS if slug != "rect"])
def test_transmittance_is_that_of_the_formula(slug):
    """Inside the exposure alone, with the efficiency that follows."""
    command = SHUTTERS[slug].shutter()
    light = _light(command)
    found = np.asarray(light.transmittance(TAU))
    expected = T * (LEAKAGE + (1 - LEAKAGE) * np.asarray(command.transmittance(TAU)))
    np.testing.assert_allclose(found, np.where(np.abs(TAU) <= 1, expected, 0), atol=1e-6)
    efficiency = T * (LEAKAGE + (1 - LEAKAGE) * float(command.efficiency()))
    assert float(light.efficiency()) == pytest.approx(efficiency, rel=1e-6)
    assert type(command_of(light)) is type(command)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 810.0])
@pytest.mark.parametrize("slug", ["hann", "spline", "flutter"])
def test_kernels_are_a_mixture(slug, speed):
    """Of the kernels of the profile and of an open shutter; so are transfer functions."""
    command = SHUTTERS[slug].shutter()
    frequency = np.array([0.03, 0.2, 0.47])
    for function in (
        lambda shutter: blur_kernel(shutter, MOTION, speed=speed, num_taps=32),
        lambda shutter: transfer_function(shutter, MOTION, frequency=frequency, speed=speed),
    ):
        light, own, opened = (
            np.asarray(function(s)) for s in (_light(command), command, RectShutter())
        )
        mixture = T * (LEAKAGE * opened + (1 - LEAKAGE) * own)
        np.testing.assert_allclose(light, mixture, atol=2e-6)


class Pane(AbstractShutter):
    """A shutter of a user's own that is open from the first moment to the last, if it is clear."""

    clear: np.ndarray

    def transmittance(self, tau):
        return jnp.where(jnp.abs(tau) <= 1, self.clear, 0.0)


ONES = np.ones(7)
OPEN = {
    "rect": RectShutter(),
    "tukey": TukeyShutter(0.0),
    "spline": SplineShutter(ONES),
    "folded spline": SplineShutter(ONES, symmetric=True, num_coefficients=13),
    "chips": ChippedShutter(ONES),
    "own": Pane(np.asarray(1.0)),
}


@pytest.mark.parametrize("slug", OPEN)
def test_an_open_shutter_needs_no_device(slug):
    """Whatever its class it loses nothing; what has been through a device is not sent again."""
    opened, light = OPEN[slug], SCENE.light(HannShutter(), MOTION)
    for make in DEVICES.values():
        assert make().light(opened, HALF, np.dtype(float)) is opened
    assert SCENE.light(opened, MOTION) is opened
    assert SCENE.light(light, MOTION) is light
    behind = DEVICE.behind(opened, HALF, np.dtype(float))
    assert float(behind.efficiency()) == pytest.approx(T, rel=1e-6)
    assert SCENE.light(behind, MOTION) is behind


def test_open_shutters_are_as_good_as_one_another():
    """By every metric of the scene; a little less than open, they pay for the device."""
    rect = evaluate(SCENE, MOTION, RectShutter())
    assert float(rect.efficiency) == 1
    for opened in (OPEN["tukey"], OPEN["spline"], OPEN["chips"], OPEN["own"]):
        found = evaluate(SCENE, MOTION, opened)
        assert float(found.efficiency) == pytest.approx(1, rel=1e-6)
        assert float(found.expected_psnr) == pytest.approx(float(rect.expected_psnr), abs=1e-4)
    dimmer = np.where(np.arange(7) == 4, 0.995, 1.0)
    for closing in (ChippedShutter(dimmer), SplineShutter(dimmer), Pane(np.asarray(0.995))):
        light, mean = SCENE.light(closing, MOTION), float(closing.efficiency())
        assert mean > 0.99
        behind = T * (LEAKAGE + (1 - LEAKAGE) * mean)
        assert float(light.efficiency()) == pytest.approx(behind, rel=1e-6)


@pytest.mark.parametrize("slug", ["lossy", *DEVICES])
def test_the_value_of_a_traced_profile_decides_for_a_device(slug):
    """Under `jit` and `vmap` as outside; the slope at an open profile is finite."""
    device = DEVICE if slug == "lossy" else DEVICES[slug]()
    scene = Scene(SCENE.speeds, **LIGHT, device=device)

    def light(levels):
        return scene.light(ChippedShutter(levels), MOTION).efficiency()

    rows = jnp.stack([jnp.ones(8), jnp.full(8, 1.0).at[3].set(0.5), jnp.zeros(8)])
    known = [float(light(row)) for row in rows]
    assert known[0] == pytest.approx(1, rel=1e-6)
    assert known[1] < float(device.transmission) + 1e-6
    np.testing.assert_allclose(jax.jit(jax.vmap(light))(rows), known, rtol=1e-6)
    assert np.all(np.isfinite(jax.jit(jax.grad(light))(rows[0])))


def test_whatever_is_measured_is_of_the_light():
    """Metrics, decoders and captures of a profile are those of its transmittance."""
    command, light = HannShutter(), SCENE.light(HannShutter(), MOTION)
    first, second = (evaluate(SCENE, MOTION, shutter) for shutter in (command, light))
    assert str(first) == str(second)
    assert float(first.efficiency) == pytest.approx(T * (LEAKAGE + (1 - LEAKAGE) / 2))
    models = [blur_model(SCENE, MOTION, shutter) for shutter in (command, light)]
    np.testing.assert_array_equal(models[0].responses(96), models[1].responses(96))
    grey = np.full((4, 64), 0.5)
    still = StillCamera(half_exposure=1e-3)
    captured = np.asarray(simulate_capture(grey, SCENE, still, command))
    np.testing.assert_allclose(captured, 0.5 * float(first.efficiency), rtol=1e-6)


def test_a_transmission_is_as_good_as_less_light():
    """Read noise aside, which stays: a device of 40 % is 40 % of the photon rate."""
    plain = Scene(SCENE.speeds, photon_rate=4e4, read_noise=5.0)
    lossy = Scene(SCENE.speeds, **LIGHT, device=IdealDevice(transmission=0.4))
    levels = [float(evaluate(s, MOTION, HannShutter()).expected_psnr) for s in (plain, lossy)]
    assert levels[0] == pytest.approx(levels[1], abs=1e-5)


@pytest.mark.slow
def test_derivatives_pass_through_a_device():
    """By the transmission, against a central difference."""

    def level(transmission):
        scene = Scene(SCENE.speeds, **LIGHT, device=IdealDevice(transmission=transmission))
        return evaluate(scene, MOTION, HannShutter()).expected_psnr

    step = 1e-2 if np.finfo(np.asarray(level(0.5)).dtype).bits == 32 else 1e-4
    slope = (level(0.5 + step) - level(0.5 - step)) / (2 * step)
    assert float(jax.grad(level)(0.5)) == pytest.approx(float(slope), rel=2e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("transmission", 0.0), ("transmission", 1.1), ("leakage", -0.1), ("leakage", 1.0)]
    + [(name, np.nan) for name in ("transmission", "leakage")],
)
def test_a_device_that_is_none(name, value):
    """One line says which number is out of its range."""
    with pytest.raises(ValueError, match=f"`IdealDevice\\({name}=...\\)` must be"):
        IdealDevice(**{name: value})


def test_a_pixel_holds_some_electrons():
    """None at all is refused by name."""
    with pytest.raises(ValueError, match=r"`Sensor\(full_well=...\)` must be above 0"):
        Scene([0.0], **LIGHT, sensor=Sensor(full_well=0.0))


class Ramp(AbstractShutter):
    """A shutter of a user's own, which is interpolated."""

    def transmittance(self, tau):
        return jnp.where(jnp.abs(tau) <= 1, (1 + jnp.asarray(tau)) / 2, 0.0)


def test_a_shutter_of_ones_own_comes_back_as_itself():
    """Interpolated on its way through a device."""
    ramp = Ramp()
    light = SCENE.light(ramp, MOTION)
    assert command_of(light) is ramp
    assert float(light.efficiency()) == pytest.approx(T * (LEAKAGE + (1 - LEAKAGE) / 2))


HALF = float(MOTION.half_exposure)
LEVELS = np.array([0.31, 0.9, 0.0, 0.0, 0.62, 1.0, 0.17])
TIMES = {
    "usual": (1.9e-3, 4.3e-3, 0.0),
    "late": (1.9e-3, 0.6e-3, 3.1e-3),
    "later-than-all": (1.9e-3, 0.6e-3, 0.05),
    "fast": (3.3e-6, 1.7e-5, 0.0),
    "at-once": (0.0, 0.0, 1.2e-3),
    "one-way": (0.0, 2.7e-3, 0.0),
    "slow": (310.0, 4.1e3, 0.0),
}


def test_a_device_without_its_levels_keeps_all_else():
    """What is searched is the light of the same device, late by the same delay."""
    given = {"rise_time": 310e-6, "fall_time": 120e-6, "num_slots": 7, "delay": 230e-6}
    given |= {"transmission": 0.7, "leakage": 0.02}
    device = FirstOrderDevice(**given, levels=4)
    assert eqx.tree_equal(device.relaxed, FirstOrderDevice(**given))
    ideal = IdealDevice(transmission=0.7, leakage=0.02, levels=4)
    assert eqx.tree_equal(ideal.relaxed, IdealDevice(transmission=0.7, leakage=0.02))
    # The profile keeps to levels that the device has, so that these change nothing.
    profile = ChippedShutter([0.0, 1 / 3, 1.0, 1.0, 2 / 3, 1.0, 0.0])
    tau = jnp.linspace(-0.9, 0.9, 19)
    found, right = (
        each.light(profile, 4e-3, np.dtype(np.float64)).transmittance(tau)
        for each in (device.relaxed, device)
    )
    np.testing.assert_allclose(found, right, rtol=1e-12)


def _lagged(times, **others):
    rise, fall, delay = times
    return FirstOrderDevice(rise_time=rise, fall_time=fall, num_slots=7, delay=delay, **others)


def _events(times):
    """States at the ends of slots at 50 digits: `(begin, end, level, state, constant)`."""
    rise, fall, delay = (mp.mpf(x) for x in times)
    half, count = mp.mpf(HALF), len(LEVELS)
    ends = [-half + delay + 2 * half * k / count for k in range(1, count)]
    inner = [max(-half, min(half, end)) for end in ends]
    state, found = mp.mpf(float(LEVELS[0])), []
    for begin, end, level in zip([-half, *inner], [*inner, half], LEVELS, strict=True):
        constant = (rise if level > state else fall) / mp.log(9)
        found.append((begin, end, mp.mpf(float(level)), state, constant))
        state = _state(found[-1], end)
    return found


def _state(event, time):
    begin, _, level, start, constant = event
    if time == begin:
        return start
    return level + (start - level) * (mp.exp(-(time - begin) / constant) if constant else 0)


def _integral(event):
    begin, end, level, start, constant = event
    way = (1 - mp.exp(-(end - begin) / constant)) * constant if constant and end > begin else 0
    return level * (end - begin) + (start - level) * way


def test_every_device_is_a_case():
    """No final class of a device is left out of the contract tests."""
    classes = final_classes(mishutter, AbstractDevice)
    assert classes == {type(make()) for make in DEVICES.values()}
    assert classes == set(devices.DEVICES)


def test_a_file_finds_a_device_by_its_arguments():
    """The first in the list that has them: times are gradual, slots without levels switch."""
    for names, kind in (
        ("transmission leakage", IdealDevice),
        ("levels", IdealDevice),
        ("levels num_slots", IdealDevice),
        ("rise_time fall_time levels num_slots", FirstOrderDevice),
        ("fall_time", FirstOrderDevice),
        ("num_slots leakage", SwitchedDevice),
        ("min_open", SwitchedDevice),
        ("min_closed transmission", SwitchedDevice),
    ):
        assert next(each for each in devices.DEVICES if each.has(names.split())) is kind, names


@pytest.mark.parametrize("slug", DEVICES)
def test_what_a_device_makes_of_a_command(slug):
    """Lies between leakage and transmission, is not sent again, and leaves an open one open."""
    device = DEVICES[slug]()
    light = device.light(HannShutter(), HALF, np.dtype(float))
    found = np.asarray(light.transmittance(np.linspace(-1, 1, 173)))
    t, closed = float(device.transmission), float(device.transmission * device.leakage)
    assert closed - 1e-9 <= found.min() < found.max() <= t + 1e-9
    assert device.light(light, HALF, np.dtype(float)) is light
    opened = RectShutter()
    assert device.light(opened, HALF, np.dtype(float)) is opened
    again = device.light(command_of(light), HALF, np.dtype(float))
    np.testing.assert_allclose(np.asarray(again.transmittance(TAU)), light.transmittance(TAU))


@pytest.mark.parametrize(
    "slug", ["late", *(pytest.param(x, marks=pytest.mark.slow) for x in TIMES if x != "late")]
)
def test_the_state_of_a_first_order_device_is_exact(slug):
    """Its values and its light against 50 digits, of times from none to for ever."""
    times = TIMES[slug]
    with mp.workdps(50):
        events = _events(times)
        tau = np.array([-1.0, -0.93, -0.72, -0.713, -0.4285, -0.2, 0.01, 0.33, 0.7143, 0.9, 1.0])
        exact = []
        for x in tau:
            time = mp.mpf(float(x)) * mp.mpf(HALF)
            event = [e for e in events if e[0] <= time <= e[1] and e[0] < e[1]][-1]
            exact.append(float(_state(event, time)))
        efficiency = float(sum(map(_integral, events)) / (2 * mp.mpf(HALF)))
    light = _lagged(times).light(ChippedShutter(LEVELS), HALF, np.dtype(float))
    tight = np.finfo(np.asarray(light.transmittance(0.0)).dtype).bits == 64
    atol = 2e-12 if tight else 2e-5
    np.testing.assert_allclose(np.asarray(light.transmittance(tau)), exact, rtol=0, atol=atol)
    assert float(light.efficiency()) == pytest.approx(efficiency, abs=atol)


def test_a_mean_from_closed_keeps_its_digits():
    """Light that has just begun to rise is exact relative to itself, not to full light."""
    with mp.workdps(40):
        constant = mp.mpf("1.9e-3") / mp.log(9)
        width = mp.mpf("1e-9")  # of the slot after the second closed one begins
        exact = float(1 - (1 - mp.exp(-width / constant)) * constant / width)
    device = FirstOrderDevice(rise_time=1.9e-3, fall_time=0.0, num_slots=2)
    profile = device.light(ChippedShutter([0.0, 1.0]), HALF, np.dtype(float)).profile
    tau = width / mp.mpf(HALF)
    wide = jnp.asarray([float(tau)])
    piece = jnp.asarray([2])
    found = profile.piece_mean(piece, piece > 0, wide / 2, wide)
    precise = found.dtype == np.float64
    assert float(found[0]) == pytest.approx(exact, rel=1e-13 if precise else 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["late", "fast"])
def test_responses_are_those_of_a_simulation_in_time(slug):
    """Kernels and transfer functions against sums over times between which little changes."""
    light = _lagged(TIMES[slug]).light(ChippedShutter(LEVELS), HALF, np.dtype(float))
    ends = np.linspace(-1, 1, 400_001)
    tau = (ends[1:] + ends[:-1]) / 2
    opened, speed, a = np.asarray(light.transmittance(tau)), 430.0, float(MOTION.acceleration)
    x = a * (tau * HALF) ** 2 - speed * tau * HALF
    taps = np.histogram(x + speed**2 / (4 * a), np.arange(49), weights=opened)[0] / tau.size
    kernel = np.asarray(blur_kernel(light, MOTION, speed=speed, num_taps=48))
    np.testing.assert_allclose(kernel, taps, atol=1e-5)
    frequency = np.array([0.013, 0.11, 0.47])
    waves = np.exp(-2j * np.pi * np.outer(frequency, x)) @ opened / tau.size
    found = np.asarray(transfer_function(light, MOTION, speed=speed, frequency=frequency))
    np.testing.assert_allclose(found, waves, atol=1e-5)


def test_a_level_that_is_held_is_at_rest():
    """A constant command is its own light: the first level has been held since long before."""
    light = _lagged(TIMES["late"]).light(ChippedShutter(np.full(7, 0.37)), HALF, np.dtype(float))
    np.testing.assert_allclose(np.asarray(light.transmittance(np.linspace(-1, 1, 9))), 0.37)


def test_a_device_settles_from_any_level():
    """A thousandth of the way is left after `settling_time`, be it open or closed before."""
    device = _lagged(TIMES["late"])
    rise, fall, delay = (float(x) for x in (device.rise_time, device.fall_time, device.delay))
    way = np.exp(-(float(device.settling_time) - delay) * np.log(9) / max(rise, fall))
    assert way == pytest.approx(1e-3, rel=1e-4)
    assert float(IdealDevice(num_slots=9).settling_time) == 0


@jax.jit
def _number(times, half, levels):
    """Efficiency and taps, in one number, of levels through a device."""
    device = FirstOrderDevice(rise_time=times[0], fall_time=times[1], num_slots=7, delay=times[2])
    motion = ParabolicMotion(acceleration=2e5, half_exposure=half)
    light = device.light(ChippedShutter(levels), half, np.dtype(levels.dtype))
    kernel = blur_kernel(light, motion, speed=430.0, num_taps=32)
    return light.efficiency() + kernel @ jnp.asarray(np.cos(np.arange(32)), kernel.dtype)


@pytest.mark.slow
def test_gradients_of_a_first_order_device():
    """By its times, the exposure and each level, against central differences."""
    wide = jnp.zeros(()).dtype == jnp.float64
    start = [1.9e-3, 4.3e-3, 1.7e-3], HALF, np.clip(LEVELS, 0.05, 0.95)
    arguments = tuple(jnp.asarray(x, float) for x in start)
    gradient = jax.jit(jax.grad(_number, argnums=(0, 1, 2)))(*arguments)
    for index, (slopes, argument) in enumerate(zip(gradient, arguments, strict=True)):
        scale = np.abs(np.asarray(slopes)).max()
        for place in np.ndindex(argument.shape):
            step = (1e-6 if wide else 1e-2) * float(argument[place])
            ends = []
            for sign in (1, -1):
                moved = list(arguments)
                moved[index] = argument.at[place].add(sign * step)
                ends.append(float(_number(*moved)))
            found, difference = float(slopes[place]), (ends[0] - ends[1]) / (2 * step)
            assert found == pytest.approx(difference, abs=(2e-6 if wide else 5e-2) * scale)


@pytest.mark.slow
def test_a_symmetric_command_is_no_symmetric_light():
    """Speeds of either sign are told apart, as by a plan that folds none."""
    device = FirstOrderDevice(rise_time=3e-3, fall_time=8e-3)
    scene = Scene([-900.0, 0.0, 900.0], **LIGHT, device=device)
    planned = evaluate(scene, MOTION, HannShutter())
    whole = metrics_by(None, scene, MOTION, HannShutter())
    assert float(planned.expected_psnr) == pytest.approx(float(whole["expected_psnr"]), abs=1e-5)
    assert float(planned.kernel_difference) == pytest.approx(float(whole["kernel_difference"]))


@pytest.mark.parametrize("slug", ["hann", "tukey", "flutter", "spline", "triangle"])
def test_slots_hold_means(slug):
    """Of any profile: over all of them they are its efficiency, and each that of fine samples."""
    shutter = SHUTTERS[slug].shutter()
    light = IdealDevice(num_slots=13).light(shutter, HALF, np.dtype(float))
    assert float(light.efficiency()) == pytest.approx(float(shutter.efficiency()), abs=1e-6)
    fine = np.asarray(shutter.transmittance((np.arange(13 * 4096) + 0.5) / (13 * 2048) - 1))
    middles = np.arange(13) * (2 / 13) - 1 + 1 / 13
    means = fine.reshape(13, -1).mean(axis=1)
    np.testing.assert_allclose(np.asarray(light.transmittance(middles)), means, atol=1e-4)


def test_error_diffusion_keeps_light():
    """To half a level over the whole, and levels that are there already stay."""
    means = np.clip(0.5 + 0.5 * np.sin(np.arange(97) / 11), 0, 1)
    for levels in (2, 3, 7):
        found = np.asarray(diffused(jnp.asarray(means), levels))
        assert abs(found.sum() - means.sum()) <= 0.51 / (levels - 1)
        np.testing.assert_allclose(found * (levels - 1) % 1, 0, atol=1e-5)
        np.testing.assert_array_equal(np.asarray(diffused(jnp.asarray(found), levels)), found)


def test_runs_of_a_switched_shutter_are_long_enough():
    """As many slots in a row are open and closed as the device needs, ends aside."""
    means = np.clip(0.5 + 0.6 * np.sin(np.arange(97) / 7), 0, 1)
    found = np.asarray(diffused(jnp.asarray(means), 2, min_open=3, min_closed=4))
    assert runs_are_long_enough(np.rint(found).astype(int)[None], 3, 4).all()
    assert abs(found.sum() - means.sum()) <= 4
    rows = np.array([[1, 0, 0, 1, 1, 0], [0, 1, 0, 0, 1, 1], [0, 1, 1, 0, 1, 1]])
    assert runs_are_long_enough(rows, 2, 2).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("means", "shortest", "slots"),
    [
        ([0.8, 0.1, 0.1, 0.1, 0.9, 0.9, 0.3], (3, 2), [1, 0, 0, 0, 1, 1, 1]),
        ([0.1, 0.1, 0.9, 0.9, 0.9, 0.2, 0.1, 0.7], (2, 5), [0, 0, 1, 1, 1, 0, 0, 0]),
        ([0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0], (2, 3), [0, 1, 1, 0, 0, 0, 1, 1]),
    ],
    ids=["open", "closed", "no longer than needed"],
)
def test_a_run_from_before_the_exposure_ends_when_it_likes(means, shortest, slots):
    """As a search has it, only runs that begin within the exposure are held."""
    found = np.asarray(diffused(jnp.asarray(means), 2, *shortest))
    np.testing.assert_array_equal(found, slots)
    assert runs_are_long_enough(np.rint(found).astype(int)[None], *shortest).all()


def test_slots_of_a_profile_of_ones_own():
    """Whose pieces are interpolants: the mean of a ramp over each slot."""
    light = SwitchedDevice(num_slots=8).light(Ramp(), HALF, np.dtype(float))
    assert isinstance(command_of(light), ChippedShutter)
    assert float(light.efficiency()) == pytest.approx(0.5, abs=1 / 16 + 1e-6)
    profile = TriangleShutter()
    means = slot_means(profile, 4, np.dtype(float))
    np.testing.assert_allclose(np.asarray(means), [0.25, 0.75, 0.75, 0.25], rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: FirstOrderDevice(rise_time=-1e-3, fall_time=1.0), r"rise_time=...\)` must"),
        (
            lambda: FirstOrderDevice(rise_time=1.0, fall_time=np.nan),
            r"fall_time=...\)` must",
        ),
        (
            lambda: FirstOrderDevice(rise_time=1.0, fall_time=1.0, delay=-1.0),
            r"delay=...\)` must be at least 0",
        ),
        (lambda: SwitchedDevice(num_slots=1), r"num_slots=...\)` must be 2 to 4096; got 1"),
        (lambda: SwitchedDevice(min_open=0), r"min_open=...\)` must be a positive integer"),
        (
            lambda: SwitchedDevice(min_open=200),
            r"`SwitchedDevice\(min_open=...\)` must be at most num_slots = 128; got 200\.",
        ),
        (
            lambda: SwitchedDevice(num_slots=7, min_closed=8),
            r"`SwitchedDevice\(min_closed=...\)` must be at most num_slots = 7; got 8\.",
        ),
        (lambda: IdealDevice(levels=1), r"levels=...\)` must be 2 to 65536; got 1"),
        (
            lambda: SwitchedDevice(leakage=1.0),
            r"`SwitchedDevice\(leakage=...\)` must be at",
        ),
    ],
)
def test_numbers_that_no_device_has(make, text):
    """Are refused in one line."""
    with pytest.raises(ValueError, match=text):
        make()
