"""The operator of PyTorch is the capture: its values, its adjoint, and its gradients."""

import doctest
import re
import sys
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from mishutter import (
    FirstOrderDevice,
    FreeMotion,
    HannShutter,
    Optics,
    ParabolicMotion,
    Scene,
    Sensor,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    centred_kernel,
    simulate_capture,
)

torch = pytest.importorskip("torch", reason="PyTorch is not installed")

import mishutter.torch  # noqa: E402 - where there is PyTorch
from mishutter.torch import Blur, blurred, differentiable, physics  # noqa: E402

SCENE = Scene([-310.0, 420.0], photon_rate=2.3e5, read_noise=3.7, optics=Optics(lens_blur=0.4))
ALONG_COLUMNS = Scene(
    [-310.0, 420.0], photon_rate=2.3e5, read_noise=3.7, sensor=Sensor(axis="columns")
)
MOTION = ParabolicMotion(acceleration=1.3e5, half_exposure=0.0117, velocity=43.0)
SHUTTER = TukeyShutter(0.37)
SPEED = 431.0
MOTIONS = {
    "parabola": MOTION,
    "still": StillCamera(half_exposure=0.0071),
    "free path": FreeMotion(accelerations=[0.9e5, 2.1e5], half_exposure=0.0093, velocity=-21.0),
}
BY_TORCH_JIT = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated")
"""Which PyTorch calls when it differentiates forwards."""
BORDERS = ["reflect", "edge", "wrap", "zero", "scene"]


def pictures(*shape):
    return np.random.default_rng(7).random(shape)


def captured(light, scene, motion, border):
    """The capture of a batch with its colours before the rows."""
    channels_last = np.moveaxis(light, -3, -1)
    arguments = {"speed": SPEED, "border": border}
    capture = simulate_capture(channels_last, scene, motion, SHUTTER, **arguments)
    return np.moveaxis(np.asarray(capture), -1, -3)


@pytest.mark.parametrize("scene", [SCENE, ALONG_COLUMNS], ids=["rows", "columns"])
@pytest.mark.parametrize("border", BORDERS)
def test_it_is_the_capture(border, scene):
    """Batches and colours of every border, along rows and columns, to rounding."""
    light = pictures(2, 3, 87, 91)
    blur = Blur(scene, MOTION, SHUTTER, speed=SPEED, border=border)
    expected = captured(light, scene, MOTION, border)
    np.testing.assert_allclose(blur(torch.from_numpy(light)).numpy(), expected, atol=1e-13)


@pytest.mark.parametrize("slug", MOTIONS)
def test_it_is_the_capture_on_every_path(slug):
    """A camera at rest and a free path too, by both forms."""
    light = pictures(1, 1, 3, 101)
    expected = captured(light, SCENE, MOTIONS[slug], "zero")
    by_speed = {"speed": SPEED, "border": "zero"}
    tensor = torch.from_numpy(light)
    fixed = Blur(SCENE, MOTIONS[slug], SHUTTER, **by_speed)(tensor)
    learnt = blurred(tensor, SCENE, lambda: (MOTIONS[slug], SHUTTER), **by_speed)
    np.testing.assert_allclose(fixed.numpy(), expected, atol=1e-13)
    np.testing.assert_allclose(learnt.numpy(), expected, atol=1e-13)


@pytest.mark.parametrize("border", ["scene", "reflect", "edge"])
def test_a_learnt_camera_sees_along_columns_what_it_sees_along_rows(border):
    """Of single precision too, with a gradient by the speed, which is that of differences."""
    turned = eqx.tree_at(lambda scene: scene.optics, ALONG_COLUMNS, SCENE.optics)
    light = torch.from_numpy(pictures(3, 87, 101))

    def learnt(light, scene, speed):
        return blurred(light, scene, lambda: (MOTION, SHUTTER), speed=speed, border=border)

    (speed,) = numbers(SPEED)
    along = learnt(light.mT, turned, speed).mT
    expected = captured(light.numpy()[None], SCENE, MOTION, border)[0]
    np.testing.assert_allclose(along.detach().numpy(), expected, atol=1e-12)
    narrow = learnt(light.float(), SCENE, SPEED)
    assert narrow.dtype == torch.float32
    torch.testing.assert_close(narrow.double(), along.detach(), atol=1e-6, rtol=0)
    weights = torch.from_numpy(np.random.default_rng(5).standard_normal(along.shape))
    (along * weights).sum().backward()
    with torch.no_grad():
        values = [(learnt(light, SCENE, SPEED + d) * weights).sum() for d in (0.01, -0.01)]
    torch.testing.assert_close(speed.grad, (values[0] - values[1]) / 0.02, rtol=1e-4, atol=0)


def test_it_is_the_capture_behind_a_device_that_lags():
    """The fixed operator, as the learnt one, has the light that comes through."""
    device = FirstOrderDevice(rise_time=7e-4, fall_time=1.3e-3)
    scene = Scene([-310.0, 420.0], photon_rate=2.3e5, read_noise=3.7, device=device)
    light = pictures(1, 1, 3, 101)
    expected = captured(light, scene, MOTION, "zero")
    tensor, by_speed = torch.from_numpy(light), {"speed": SPEED, "border": "zero"}
    late = Blur(scene, MOTION, SHUTTER, **by_speed)(tensor)
    learnt = blurred(tensor, scene, lambda: (MOTION, SHUTTER), **by_speed)
    np.testing.assert_allclose(late.numpy(), expected, atol=1e-13)
    np.testing.assert_allclose(learnt.numpy(), expected, atol=1e-6)
    assert np.max(np.abs(captured(light, SCENE, MOTION, "zero") - expected)) > 1e-3


def test_it_convolves_with_the_kernel_of_numpy():
    """Of a picture without detail finer than 0.4 cycles/px, in the dark beyond its borders."""
    taps = np.sinc(0.6 * np.arange(-60, 61)) * np.hanning(121)
    smooth = scipy.signal.convolve(np.pad(pictures(4, 60), ((0, 0), (150, 150))), taps[None])
    kernel = centred_kernel(MOTION, SHUTTER, speed=SPEED, lens_blur=0.4)
    expected = scipy.signal.convolve(smooth, kernel, mode="same")
    blur = Blur(SCENE, MOTION, SHUTTER, speed=SPEED, border="zero")
    np.testing.assert_allclose(blur(torch.from_numpy(smooth)).numpy(), expected, atol=2e-5)


@pytest.mark.parametrize("columns", [88, 91])
@pytest.mark.parametrize("scene", [SCENE, ALONG_COLUMNS], ids=["rows", "columns"])
@pytest.mark.parametrize("border", BORDERS)
def test_the_adjoint_has_the_same_inner_product(border, scene, columns):
    """<A x, y> = <x, A' y> of every border, of even and odd lengths."""
    blur = Blur(scene, MOTION, SHUTTER, speed=SPEED, border=border)
    x = torch.from_numpy(pictures(2, 1, columns, columns))
    y = torch.from_numpy(np.random.default_rng(8).standard_normal(blur(x).shape))
    assert blur.adjoint(y).shape == x.shape
    torch.testing.assert_close((blur(x) * y).sum(), (x * blur.adjoint(y)).sum())


def test_the_adjoint_has_a_gradient():
    """A network that is unrolled goes back through it: its adjoint is the operator."""
    blur = Blur(SCENE, MOTION, SHUTTER, speed=SPEED, border="edge")
    x, y = (torch.from_numpy(pictures(2, 5, 90)[k]) for k in (0, 1))
    y.requires_grad_()
    (blur.adjoint(y) * x).sum().backward()
    torch.testing.assert_close(y.grad, blur(x))


def of_spline(coefficients, acceleration, half_exposure):
    motion = ParabolicMotion(
        acceleration=1e5 * acceleration, half_exposure=0.01 * half_exposure, velocity=43.0
    )
    return motion, SplineShutter(coefficients)


def numbers(*values):
    tensors = (torch.tensor(value, dtype=torch.float64) for value in values)
    return tuple(tensor.requires_grad_() for tensor in tensors)


@pytest.mark.slow
def test_gradients_are_those_of_differences():
    """By the picture, the profile, the acceleration, the exposure and the speed."""
    light = torch.from_numpy(pictures(1, 2, 50)).requires_grad_()
    *of_camera, speed = numbers([0.3, 0.8, 0.6, 0.9, 0.4, 0.7], 1.3, 1.17, 4.31)

    def capture(light, speed, *camera):
        return blurred(light, SCENE, of_spline, *camera, speed=100 * speed)

    assert torch.autograd.gradcheck(capture, (light, speed, *of_camera), eps=1e-5, atol=1e-7)


@pytest.mark.slow
def test_a_camera_is_traced_once_for_all_steps():
    """A step of a training calls it with its numbers once more, to check these."""
    calls = []

    def camera(acceleration):
        calls.append(acceleration)
        return ParabolicMotion(acceleration=acceleration, half_exposure=0.0117), HannShutter()

    light = torch.from_numpy(pictures(1, 2, 50))
    for acceleration in numbers(1.1e5, 1.2e5, 1.3e5):
        before = len(calls)
        blurred(light, SCENE, camera, acceleration).sum().backward()
        assert acceleration.grad != 0
    assert len(calls) - before == 1


@pytest.mark.slow
def test_a_learnt_profile_goes_through_the_device():
    """The light is that of what a lagging device makes of it, as in a capture."""
    device = FirstOrderDevice(rise_time=7e-4, fall_time=1.3e-3)
    scene = Scene([-310.0, 420.0], photon_rate=2.3e5, read_noise=3.7, device=device)
    *camera, _ = numbers([0.3, 0.8, 0.6, 0.9, 0.4, 0.7], 1.3, 1.17, 0.0)
    light = torch.from_numpy(pictures(3, 70))
    learnt = blurred(light, scene, of_spline, *camera, speed=SPEED)
    motion, shutter = of_spline(*(jnp.asarray(each.detach().numpy()) for each in camera))
    expected = simulate_capture(light.numpy(), scene, motion, shutter, speed=SPEED)
    np.testing.assert_allclose(learnt.detach().numpy(), expected, atol=1e-6)


def test_single_precision_stays_single():
    """A picture of a network: the capture and its gradient have its type, and its values."""
    blur = Blur(SCENE, MOTION, SHUTTER, speed=SPEED)
    light = torch.from_numpy(pictures(1, 3, 80)).float().requires_grad_()
    capture = blur(light)
    capture.sum().backward()
    assert {capture.dtype, light.grad.dtype, blur.adjoint(capture).dtype} == {torch.float32}
    torch.testing.assert_close(capture.double(), blur(light.double()), atol=1e-6, rtol=0)


def test_a_function_of_jax_has_its_own_gradient():
    """Of arguments of several shapes and precisions, each in its own."""

    def function(row, scale):
        return jnp.sum(jnp.sin(row) * scale.astype(row.dtype)) * jnp.asarray([1.0, 3.0])

    row = torch.tensor([0.3, 1.1, 2.3], dtype=torch.float64, requires_grad=True)
    scale = torch.tensor(0.7, dtype=torch.float32, requires_grad=True)
    value = differentiable(function)(row, scale)
    value.sum().backward()
    sines, cosines = row.detach().sin().sum(), row.detach().cos()
    expected = sines * scale.detach() * torch.tensor([1.0, 3.0])
    torch.testing.assert_close(value.detach(), expected.double())
    narrow_first = differentiable(lambda scale, row: function(row, scale))
    torch.testing.assert_close(narrow_first(scale.detach(), row.detach()), expected.double())
    torch.testing.assert_close(row.grad, 4 * scale.detach() * cosines)
    torch.testing.assert_close(scale.grad, 4 * sines.float())


def test_values_of_two_precisions_pull_back_in_their_own():
    """PyTorch has them in the widest one, and so what comes back."""
    wide = torch.tensor([0.3, 1.1], dtype=torch.float64, requires_grad=True)
    narrow = torch.tensor([0.7, 0.2, 0.1], dtype=torch.float32, requires_grad=True)
    cube, square = differentiable(lambda x, y: (x**3, y**2))(wide, narrow)
    (cube.sum() + square.sum()).backward()
    torch.testing.assert_close(wide.grad, 3 * wide.detach() ** 2)
    torch.testing.assert_close(narrow.grad, 2 * narrow.detach())


def waves(row, scale):
    """A function of JAX whose derivatives of every order are not 0, with several values."""
    return {"waves": jnp.sin(row) * row[::-1] ** 2 * scale, "product": (jnp.prod(row) ** 2,)}


WAVES = differentiable(waves)


def first_wave(row):
    return WAVES(row, 0.7 * row[1])["waves"][0]


@BY_TORCH_JIT
def test_second_derivatives_are_those_of_jax():
    """Backwards twice, forwards after that, and of a penalty on a slope beside another term."""
    (row,) = numbers([0.3, 1.1, 2.3])
    hessian = torch.autograd.functional.hessian(first_wave, row.detach())
    expected = jax.hessian(lambda row: waves(row, 0.7 * row[1])["waves"][0])
    expected = torch.tensor(np.array(expected(jnp.asarray(row.detach().numpy()))))
    torch.testing.assert_close(hessian, expected)
    torch.testing.assert_close(torch.func.hessian(first_wave)(row.detach()), expected)
    slope = torch.autograd.grad(first_wave(row), row, create_graph=True)[0]
    (slope.square().sum() + row.sum()).backward()
    torch.testing.assert_close(row.grad, 1 + 2 * expected @ slope.detach())


def test_functions_of_torch_transform_it():
    """`vmap` and `grad`, one within the other too, with an argument that stays."""
    rows = torch.from_numpy(pictures(2, 3))
    scales = torch.tensor([0.7, -1.3], dtype=torch.float64)
    values = torch.func.vmap(WAVES)(rows, scales)["waves"]
    torch.testing.assert_close(values, torch.stack([*map(_waves_of, rows, scales)]))
    alone = torch.func.vmap(WAVES, in_dims=(None, 0))(rows[1], scales)["product"][0]
    assert alone.shape == (2,)
    slopes = torch.func.vmap(torch.func.grad(first_wave))(rows)
    each = [torch.autograd.functional.jacobian(first_wave, row) for row in rows]
    torch.testing.assert_close(slopes, torch.stack(each))


def _waves_of(row, scale):
    return WAVES(row, scale)["waves"]


def test_a_learnt_camera_is_differentiated_by_functions_of_torch():
    """A gradient by a number is that of `backward`; a batch of cameras is a line."""
    light = torch.from_numpy(pictures(2, 60))
    (rise,) = numbers(1.3)

    def light_of(rise, light):
        def camera(rise):
            return ParabolicMotion(acceleration=1e5 * rise, half_exposure=0.0117), HannShutter()

        return blurred(light, SCENE, camera, rise).square().sum()

    light_of(rise, light).backward()
    slope = torch.func.grad(light_of)(rise.detach(), light)
    torch.testing.assert_close(slope, rise.grad)
    with torch.no_grad():
        high, low = light_of(rise + 1e-5, light), light_of(rise - 1e-5, light)
    torch.testing.assert_close(slope, (high - low) / 2e-5, rtol=1e-5, atol=0)
    assert float(slope.abs()) > 1e-4
    assert torch.func.grad(light_of, argnums=1)(rise.detach(), light).shape == light.shape
    line = r"`blurred\(numbers=...\)` must be the same for all pictures; got a batch"
    with pytest.raises(ValueError, match=line):
        torch.func.vmap(light_of, in_dims=(0, None))(torch.tensor([1.1, 1.3]), light)


def test_an_empty_batch_has_empty_captures():
    """As layers of PyTorch have them, with a gradient; and so has a function of JAX."""
    blur = Blur(ALONG_COLUMNS, MOTION, SHUTTER, speed=SPEED, border="scene")
    empty = torch.zeros(0, 3, 120, 91, requires_grad=True)
    capture = blur(empty)
    assert capture.shape == (0, *blur(torch.zeros(3, 120, 91)).shape)
    assert blur.adjoint(capture).shape == empty.shape
    differentiable(jnp.sin)(capture).sum().backward()
    assert empty.grad.shape == empty.shape


class LinearPhysics(torch.nn.Module):
    """What is used of the class of deepinv 0.5."""

    def __init__(self, A, A_adjoint, noise_model):
        torch.nn.Module.__init__(self)
        self.forw, self.A_adjoint, self.noise_model = A, A_adjoint, noise_model

    def forward(self, x, **kwargs):
        return self.noise_model(self.forw(x, **kwargs), **kwargs)


class PoissonGaussianNoise(torch.nn.Module):
    """What is used of the class of deepinv 0.5."""

    def __init__(self, gain, sigma, clip_positive):
        torch.nn.Module.__init__(self)
        self.gain, self.sigma, self.clip_positive = gain, sigma, clip_positive

    def forward(self, x, gain=None):
        assert self.clip_positive
        gain = gain or self.gain
        return torch.poisson((x / gain).clip(0)) * gain + self.sigma * torch.randn(x.shape)


def test_the_physics_of_deepinv_has_the_noise_of_the_capture(monkeypatch):
    """Its operator is the blur, and its noise that of electrons, which deepinv may change."""
    module = types.ModuleType("deepinv.physics")
    module.LinearPhysics, module.PoissonGaussianNoise = LinearPhysics, PoissonGaussianNoise
    monkeypatch.setitem(sys.modules, "deepinv", types.ModuleType("deepinv"))
    monkeypatch.setitem(sys.modules, "deepinv.physics", module)
    blur = Blur(SCENE, MOTION, SHUTTER, speed=SPEED)
    own = physics(SCENE, MOTION, SHUTTER, speed=SPEED)
    grey = torch.full((300, 400), 0.47)
    torch.testing.assert_close(own.A_adjoint(grey), blur.adjoint(grey))
    torch.manual_seed(3)
    key = jax.random.key(4)
    expected = simulate_capture(grey.numpy(), SCENE, MOTION, SHUTTER, speed=SPEED, key=key)
    noise = own(grey) - blur(grey)
    assert float(noise.std()) == pytest.approx(float(np.std(expected)), rel=0.02)
    assert float((own(grey, gain=0.05) - blur(grey)).std()) > 5 * float(noise.std())
    white = 2.3e5 * 2 * 0.0117
    assert float(own(torch.zeros(300, 400)).std()) == pytest.approx(3.7 / white, rel=0.02)
    shot = torch.var(noise) - (3.7 / white) ** 2
    assert float(shot) == pytest.approx(float(blur(grey).mean()) / white, rel=0.02)
    dark = eqx.tree_at(lambda scene: scene.photon_rate, SCENE, jnp.asarray(0.0))
    with pytest.raises(ValueError, match=re.escape("`physics(scene=...)` must have a photon rate")):
        physics(dark, MOTION, SHUTTER)


WRONG = {
    "`Blur(...)(pictures=...)` must be a tensor of 32 or 64 bits; got torch.float16": lambda: Blur(
        SCENE, MOTION, SHUTTER
    )(torch.ones((3, 90), dtype=torch.float16)),
    "`Blur(...)(pictures=...)` must have rows and columns; got shape torch.Size([90])": lambda: (
        Blur(SCENE, MOTION, SHUTTER)(torch.ones(90))
    ),
    "`Blur.adjoint(captures=...)` must be a tensor of 32 or 64 bits; got torch.int64": lambda: Blur(
        SCENE, MOTION, SHUTTER
    ).adjoint(torch.ones((3, 90), dtype=torch.int64)),
    "`Blur(border=...)` must be one of scene, reflect, edge, wrap, zero; got 'circular'": lambda: (
        Blur(SCENE, MOTION, SHUTTER, border="circular")
    ),
    "`Blur(speed=...)` must be finite; got nan": lambda: Blur(
        SCENE, MOTION, SHUTTER, speed=float("nan")
    ),
    "`pictures` must have at least": lambda: Blur(SCENE, MOTION, SHUTTER, border="scene")(
        torch.ones(3, 11)
    ),
    "`ParabolicMotion(acceleration=...)` must be finite; got nan": lambda: blurred(
        torch.ones(3, 90), SCENE, of_spline, *numbers([0.7] * 5, float("nan"), 1.17)
    ),
    "`blurred(speed=...)` must be finite; got inf": lambda: blurred(
        torch.ones(3, 90), SCENE, of_spline, speed=float("inf")
    ),
    "`blurred(camera=...)` must return a motion": lambda: blurred(
        torch.ones(3, 90), SCENE, lambda: (SHUTTER, MOTION)
    ),
    "`differentiable(...)[1]` must be a tensor of floating point; got torch.int64": lambda: (
        differentiable(jnp.add)(torch.ones(2), torch.tensor([3, 4]))
    ),
    "`differentiable(...)` must be called with a tensor; got 0": lambda: differentiable(jnp.add)(),
    "`differentiable(function=...)` must return arrays of floating point; got bool": lambda: (
        differentiable(jnp.isnan)(torch.ones(2))
    ),
    "`differentiable(function=...)` must return arrays of floating point; got None": lambda: (
        differentiable(lambda row: None)(torch.ones(2))
    ),
    "`blurred(numbers=...)[1]` must be a tensor of floating point; got torch.int64": lambda: (
        blurred(torch.ones(3, 90), SCENE, of_spline, torch.ones(5), torch.tensor(3), torch.ones(()))
    ),
    "`ParabolicMotion(acceleration=...)` must be a scalar; got shape (2,)": lambda: blurred(
        torch.ones(3, 90), SCENE, of_spline, torch.ones(5), torch.ones(2), torch.ones(())
    ),
    "`Blur(...)(pictures=...)` must have rows and columns; got shape torch.Size([2, 0])": lambda: (
        Blur(SCENE, MOTION, SHUTTER)(torch.ones(2, 0))
    ),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_is_no_picture_or_camera_is_refused(message):
    """One line names the argument, what must hold and what came."""
    with pytest.raises(ValueError, match=re.escape(message)):
        WRONG[message]()


def test_print_shows_the_camera():
    """As other modules show their sizes."""
    assert "half_exposure=0.0117" in repr(Blur(SCENE, MOTION, SHUTTER, speed=SPEED))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Blur", "differentiable"])
def test_an_example_prints_what_it_shows(name):
    """Examples of docstrings, typed line by line into a fresh Python."""
    finder = doctest.DocTestFinder(recurse=False)
    (example,) = finder.find(getattr(mishutter.torch, name), name, module=False, globs={})
    result = doctest.DocTestRunner().run(example)
    assert (result.attempted, result.failed) == (len(example.examples), 0)
    assert example.examples


def test_gradients_agree_with_those_of_jax():
    """The pulled back derivative of a loss of the package is JAX's own."""

    def efficiency(taper):
        return TukeyShutter(taper).efficiency() ** 2

    (taper,) = numbers(0.43)
    differentiable(efficiency)(taper).backward()
    assert float(taper.grad) == pytest.approx(float(jax.grad(efficiency)(jnp.asarray(0.43))))
