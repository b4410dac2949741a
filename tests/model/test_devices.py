"""Devices: the transmittance that light sees, by its own formula at every level."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS

from mishutter import (
    AbstractShutter,
    HannShutter,
    IdealShutter,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    blur_kernel,
    blur_model,
    evaluate,
    simulate_capture,
    transfer_function,
)
from mishutter.model import command_of

T, LEAKAGE = 0.83, 0.07
DEVICE = IdealShutter(transmission=T, leakage=LEAKAGE)
LIGHT = {"photon_rate": 1e5, "read_noise": 5.0}
SCENE = Scene([-700.0, 0.0, 900.0], **LIGHT, device=DEVICE)
MOTION = ParabolicMotion(acceleration=2e5, half_exposure=8e-3)
TAU = np.linspace(-1.2, 1.2, 241)


def _light(shutter):
    return DEVICE.light(shutter, np.dtype(float))


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


def test_an_open_shutter_needs_no_device():
    """It loses nothing, and what has been through a device is not sent again."""
    opened, light = RectShutter(), SCENE.light(HannShutter())
    assert SCENE.light(opened) is opened
    assert SCENE.light(light) is light
    assert float(evaluate(SCENE, MOTION, opened).efficiency) == 1


def test_whatever_is_measured_is_of_the_light():
    """Metrics, decoders and captures of a profile are those of its transmittance."""
    command, light = HannShutter(), SCENE.light(HannShutter())
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
    lossy = Scene(SCENE.speeds, **LIGHT, device=IdealShutter(transmission=0.4))
    levels = [float(evaluate(s, MOTION, HannShutter()).expected_psnr) for s in (plain, lossy)]
    assert levels[0] == pytest.approx(levels[1], abs=1e-5)


def test_derivatives_pass_through_a_device():
    """By the transmission, against a central difference."""

    def level(transmission):
        scene = Scene(SCENE.speeds, **LIGHT, device=IdealShutter(transmission=transmission))
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
    with pytest.raises(ValueError, match=f"`IdealShutter\\({name}=...\\)` must be"):
        IdealShutter(**{name: value})


def test_a_pixel_holds_some_electrons():
    """None at all is refused by name."""
    with pytest.raises(ValueError, match=r"`Scene\(full_well=...\)` must be above 0"):
        Scene([0.0], **LIGHT, full_well=0.0)


class Ramp(AbstractShutter):
    """A shutter of a user's own, which is interpolated."""

    def transmittance(self, tau):
        return jnp.where(jnp.abs(tau) <= 1, (1 + jnp.asarray(tau)) / 2, 0.0)


def test_a_shutter_of_ones_own_comes_back_as_itself():
    """Interpolated on its way through a device."""
    ramp = Ramp()
    light = SCENE.light(ramp)
    assert command_of(light) is ramp
    assert float(light.efficiency()) == pytest.approx(T * (LEAKAGE + (1 - LEAKAGE) / 2))
