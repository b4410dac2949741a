r"""Blur as an operator of PyTorch, with gradients, and as a physics of deepinv.

Pictures are tensors of light, white = 1, whose last two axes are rows and columns; a batch and its
colours come before them. What comes back has their precision and lies on their device.
"""

from collections.abc import Callable, Iterable
from functools import partial, reduce
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import torch
from jaxtyping import Array, ArrayLike, Float, PyTree
from torch import Tensor

from mishutter._core.checks import (
    Unquoted,
    all_concrete,
    require,
    require_number,
    shape_of,
)
from mishutter.camera.capture import (
    captured_columns,
    captured_response,
    kernel_layout,
    nodes_of_capture,
)
from mishutter.camera.rows import edge_shares, period_of, require_border
from mishutter.evaluation.response import pixel_responses
from mishutter.model.devices import AbstractDevice
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import white_electrons
from mishutter.model.shutters.base import AbstractShutter

Camera = Callable[..., tuple[AbstractMotion, AbstractShutter]]
"""A motion and a shutter as a function of arrays."""


def differentiable(function: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """A function of JAX as one that PyTorch differentiates, as often as JAX does.

    Kernels, losses and metrics of the package are such functions. What it returns is one array, or
    several in tuples and dictionaries. `torch.func` transforms it as a function of its own.

    Raises:
        ValueError: by the function, where an argument or a value is no tensor of floating-point
            numbers.

    Examples:
        >>> import torch
        >>> from mishutter import ParabolicMotion, TukeyShutter, blur_kernel
        >>> from mishutter.torch import differentiable
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> def light(taper):
        ...     return blur_kernel(TukeyShutter(taper), motion, num_taps=64).sum()
        >>> taper = torch.tensor(0.4, requires_grad=True)
        >>> differentiable(light)(taper).backward()
        >>> print(f"{taper.grad:.2f}")
        -0.50
    """

    def of_tensors(*tensors: Tensor) -> PyTree:
        _require_floating("differentiable(...)", tensors)
        require(bool(tensors), "differentiable(...)", "be called with a tensor", 0)
        structures = []

        def flat(*arrays: Array) -> tuple[Array, ...]:
            leaves, structure = jax.tree.flatten(function(*arrays))
            structures.append(structure)
            values = tuple(map(jnp.asarray, leaves))
            are_real = bool(values) and all(
                jnp.issubdtype(value.dtype, jnp.floating) for value in values
            )
            got = Unquoted(", ".join(str(value.dtype) for value in values) or None)
            requirement = "return arrays of floating point"
            require(are_real, "differentiable(function=...)", requirement, got)
            return values

        values = _OfJax.apply(_Call(flat), *tensors)
        return jax.tree.unflatten(structures[-1], values)

    return of_tensors


class _Call:
    """A function of JAX whose values are a tuple, and what pulls their changes back."""

    def __init__(self, function: Callable[..., tuple[Array, ...]]):
        self.function = function
        self.pull: Callable[..., tuple[Array, ...]] | None = None

    def linearised(self, *arrays: Array) -> tuple[Array, ...]:
        """The values; what pulls back stays with the call."""
        values, pull = jax.vjp(self.function, *arrays)
        kinds = [value.dtype for value in values]
        self.pull = lambda *changes: pull(tuple(map(jnp.astype, changes, kinds)))
        return values

    def pulled_back(self, num_values: int) -> "_Call":
        """Changes of the arguments, as a function of changes of the values and the arguments."""

        def pulled(*arrays: Array) -> tuple[Array, ...]:
            values, pull = jax.vjp(self.function, *arrays[num_values:])
            changes = zip(arrays, values, strict=False)
            return pull(tuple(change.astype(value.dtype) for change, value in changes))

        return _Call(pulled)

    def pushed(self, num_arguments: int) -> "_Call":
        """Changes of the values, as a function of the arguments and of their changes."""

        def pushed(*arrays: Array) -> tuple[Array, ...]:
            return jax.jvp(self.function, arrays[:num_arguments], arrays[num_arguments:])[1]

        return _Call(pushed)


class _OfJax(torch.autograd.Function):
    """The values of a function of JAX, whose derivatives are such functions again."""

    @staticmethod
    def forward(call: _Call, *tensors: Tensor) -> tuple[Tensor, ...]:
        is_differentiated = any(each.requires_grad for each in tensors)
        function = call.linearised if is_differentiated else call.function
        values = function(*map(_as_array, tensors))
        widest = reduce(torch.promote_types, [each.dtype for each in tensors])
        return tuple(_as_tensor(value, widest, tensors[0].device) for value in values)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.call, *tensors = inputs
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)

    @staticmethod
    def backward(ctx: Any, *changes: Tensor) -> tuple[Tensor | None, ...]:
        call, tensors = ctx.call, ctx.saved_tensors
        if call.pull is None or torch.is_grad_enabled():  # the slopes may have slopes of their own
            slopes = _OfJax.apply(call.pulled_back(len(changes)), *changes, *tensors)
        else:
            slopes = _OfJax.apply(_Call(call.pull), *changes)
        return None, *(slope.to(each) for slope, each in zip(slopes, tensors, strict=True))

    @staticmethod
    def jvp(ctx: Any, *changes: Any) -> tuple[Tensor, ...]:
        _, *changes_of_tensors = changes
        call = ctx.call.pushed(len(changes_of_tensors))
        return _OfJax.apply(call, *ctx.saved_tensors, *changes_of_tensors)

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[int | None, ...], *inputs: Any
    ) -> tuple[tuple[Tensor, ...], tuple[int, ...]]:
        call, *tensors = inputs
        values = _OfJax.apply(_Call(jax.vmap(call.function, in_dims[1:])), *tensors)
        return values, (0,) * len(values)


def _require_floating(subject: str, tensors: Iterable[Tensor]) -> None:
    for index, tensor in enumerate(tensors):
        is_floating = isinstance(tensor, Tensor) and tensor.is_floating_point()
        got = getattr(tensor, "dtype", tensor)
        require(is_floating, f"{subject}[{index}]", "be a tensor of floating point", got)


def _as_array(tensor: Tensor) -> Array:
    return jnp.asarray(tensor.detach().cpu().numpy())


def _numbers_of(subject: str, tensors: Iterable[Tensor]) -> list[Array]:
    """The numbers of tensors, also within a function that `torch.func` differentiates."""
    numbers: list[Array] = []

    def record(*arrays: Array) -> tuple[Array, ...]:
        numbers.extend(arrays)
        return arrays

    _OfJax.apply(_Call(record), *(tensor.detach() for tensor in tensors))
    got = Unquoted("a batch of `torch.vmap`")
    require(all_concrete(numbers), subject, "be the same for all pictures", got)
    return numbers


def _as_tensor(array: ArrayLike, dtype: torch.dtype, device: torch.device) -> Tensor:
    # A copy: arrays of JAX may not be written to.
    return torch.from_numpy(np.array(array)).to(device=device, dtype=dtype)


class _Layout(NamedTuple):
    """Sizes of a capture that depend on the numbers of its motion."""

    columns: int  # Pixels along the picture's motion
    period: int  # Pixels of its rows as they are continued
    window: slice  # Pixels of these that the sensor records
    num_nodes: int  # Quadrature nodes over the exposure
    border: str  # The rule by which rows go on

    @classmethod
    def of(cls, motion: AbstractMotion, speed: float, columns: int, border: str) -> "_Layout":
        num_taps, _ = kernel_layout(motion, speed, subject="speed")
        window = slice(0, columns)
        if border == "scene":
            requirement = f"have at least {num_taps} pixels along the motion"
            require(columns >= num_taps, "pictures", requirement, columns)
            window = captured_columns(motion, speed, columns)
        num_nodes = nodes_of_capture(motion, np.asarray([speed]) - float(motion.velocity))
        return cls(columns, period_of(columns, num_taps, border), window, num_nodes, border)

    def continued(self, rows: Tensor) -> Tensor:
        """Rows continued to one period, as `mishutter.camera.rows.continued` continues arrays."""
        if self.border in ("reflect", "scene"):
            return torch.cat([rows, rows.flip(-1)], -1)
        if self.border == "edge":
            share = _as_tensor(edge_shares(self.columns, self.period), rows.dtype, rows.device)
            return torch.cat([rows, rows[..., -1:] * (1 - share) + rows[..., :1] * share], -1)
        return torch.nn.functional.pad(rows, (0, self.period - self.columns))

    def captured(self, rows: Tensor, response: Tensor) -> Tensor:
        return _filtered(self.continued(rows), response)[..., self.window]


@final
class Blur(torch.nn.Module):
    r"""The capture of a moving picture, without noise, as a linear operator on tensors.

    It computes what `simulate_capture` does, with a gradient by the picture: rows are continued,
    their spectrum is multiplied by $H_s(f)\operatorname{sinc}(f)$ and the lens, and what the sensor
    records is cut out. `blurred` also has gradients by the numbers of the camera.

    Raises:
        ValueError: if an argument is out of its range; when it is called, if pictures are no
            tensors with rows and columns of 32 or 64 bits.

    Examples:
        >>> import torch
        >>> from mishutter import HannShutter, ParabolicMotion, example_scene
        >>> from mishutter.torch import Blur
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> blur = Blur(example_scene(), motion, HannShutter(), speed=700.0)
        >>> captures = blur(torch.ones(8, 3, 64, 96))
        >>> print(tuple(captures.shape), f"{captures.mean():.3f}")
        (8, 3, 64, 96) 0.500
    """

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        shutter: AbstractShutter,
        *,
        speed: float = 0.0,
        border: str = "reflect",
    ):
        torch.nn.Module.__init__(self)
        require_scene(scene)
        require_border("Blur(border=...)", border)
        require_number("Blur(speed=...)", speed)
        self._speed, self._border, self._motion = float(speed), border, motion
        self._num_taps, _ = kernel_layout(motion, self._speed, subject="Blur(speed=...)")
        self._shutter, self._scene = scene.light(shutter, motion), scene
        self._known: dict[int, tuple[_Layout, Tensor]] = {}

    def extra_repr(self) -> str:
        """The camera and the speed, as `print` shows them."""
        return f"{self._motion!r}, {self._shutter!r}, speed={self._speed:g}"

    def forward(self, pictures: Tensor) -> Tensor:
        """The captures of pictures, in units of a fully open exposure."""
        rows = _along(pictures, self._scene, "Blur(...)(pictures=...)")
        layout, response = self._response(rows.shape[-1], rows)
        return _along(layout.captured(rows, response), self._scene, "Blur")

    def adjoint(self, captures: Tensor) -> Tensor:
        r"""The adjoint $A^\top y$: $\langle A x, y \rangle = \langle x, A^\top y \rangle$."""
        rows = _along(captures, self._scene, "Blur.adjoint(captures=...)")
        beyond = self._num_taps - 1 if self._border == "scene" else 0
        layout, response = self._response(rows.shape[-1] + beyond, rows)
        around = layout.window.start, layout.period - layout.window.stop
        wide = _filtered(torch.nn.functional.pad(rows, around), response.conj())
        like = wide[..., : layout.columns]
        pull = torch.func.vjp(layout.continued, torch.zeros_like(like))[1]
        return _along(pull(wide)[0], self._scene, "Blur")

    def _response(self, columns: int, like: Tensor) -> tuple[_Layout, Tensor]:
        """The sizes of captures of so many columns, and the response on the grid of their DFT."""
        if columns not in self._known:
            layout = _Layout.of(self._motion, self._speed, columns, self._border)
            motion, shutter, period = self._motion, self._shutter, layout.period
            response = np.array(captured_response(motion, shutter, [self._speed], period)[0])
            response = torch.from_numpy(response * self._scene.optics.response(period))
            self._known = {columns: (layout, response)}
        layout, response = self._known[columns]
        return layout, response.to(device=like.device, dtype=_complex_of(like))


def blurred(
    pictures: Tensor,
    scene: Scene,  # its speeds are not used
    camera: Camera,
    *numbers: Tensor,
    speed: Tensor | float = 0.0,  # scalar
    border: str = "reflect",
) -> Tensor:
    """Captures of pictures by a camera that is learnt, with gradients by its numbers.

    `Blur` with gradients by pictures, numbers and speed: of a shutter that is learnt together with
    the network that restores, or of a speed that is fitted.

    Raises:
        ValueError: as `Blur`, or if the numbers are those of no motion or shutter, or differ within
            a `torch.vmap`.
    """
    require_scene(scene)
    require_border("blurred(border=...)", border)
    rows = _along(pictures, scene, "blurred(pictures=...)")
    told = speed if isinstance(speed, Tensor) else torch.tensor(speed, dtype=torch.float64)
    _require_floating("blurred(numbers=...)", numbers)
    (number,) = _numbers_of("blurred(speed=...)", [told])
    require_number("blurred(speed=...)", number)
    motion, _ = camera(*_numbers_of("blurred(numbers=...)", numbers) if numbers else ())
    require(isinstance(motion, AbstractMotion), "blurred(camera=...)", "return a motion", motion)
    layout = _Layout.of(motion, float(number), rows.shape[-1], border)
    sizes = layout.period, layout.num_nodes
    parts = partial(_parts_of_response, scene.device, camera, sizes)
    real, imaginary = differentiable(parts)(told, *numbers).to(rows.device)
    lens = _as_tensor(scene.optics.response(layout.period), rows.dtype, rows.device)
    response = torch.complex(real, imaginary).to(_complex_of(rows)) * lens
    return _along(layout.captured(rows, response), scene, "blurred")


@eqx.filter_jit
def _parts_of_response(
    device: AbstractDevice | None,
    camera: Camera,
    sizes: tuple[int, int],
    speed: Array,
    *numbers: Array,
) -> Float[Array, "2 k"]:
    """Real and imaginary part of the response of a camera, without the lens."""
    motion, shutter = camera(*numbers)
    period, num_nodes = sizes
    dtype = motion.velocity.dtype
    if device is not None:
        shutter = device.light(shutter, motion.half_exposure, np.dtype(dtype))
    relative = jnp.reshape(speed.astype(dtype) - motion.velocity, 1)
    still = motion.without_velocity()
    response = pixel_responses(shutter, still, relative, period, num_nodes=num_nodes)[0]
    return jnp.stack([response.real, response.imag])


def physics(
    scene: Scene,  # its speeds are not used
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    speed: float = 0.0,
    border: str = "reflect",
) -> Any:
    r"""The capture of a moving picture as a `deepinv.physics.LinearPhysics`, with its noise.

    `A` and `A_adjoint` are those of `Blur`, and the noise is that of `simulate_capture`, Poisson of
    the scene's light and Gaussian of its read noise; `A_dagger`, `prox_l2` and deepinv's solvers
    follow. deepinv is an extra of the package (`pip install 'mishutter[deepinv]'`).

    Raises:
        ValueError: as `Blur`, or if the scene has no light.
        ImportError: if deepinv is not installed.
    """
    from deepinv.physics import (  # pyright: ignore[reportMissingImports]
        LinearPhysics,
        PoissonGaussianNoise,
    )

    blur = Blur(scene, motion, shutter, speed=speed, border=border)
    rate = float(scene.photon_rate)
    require(rate > 0, "physics(scene=...)", "have a photon rate above 0 e-/s", rate)
    white = float(white_electrons(rate, float(motion.exposure)))
    noise = PoissonGaussianNoise(
        gain=1 / white,
        sigma=float(scene.read_noise) / white,
        clip_positive=True,  # waves beside an edge pass below 0
    )
    # deepinv hands parameters of the noise to the operator too.
    return LinearPhysics(
        A=lambda pictures, **_: blur(pictures),
        A_adjoint=lambda captures, **_: blur.adjoint(captures),
        noise_model=noise,
    )


def _along(pictures: Tensor, scene: Scene, subject: str) -> Tensor:
    """Pictures whose rows lie along the motion; a second call turns them back."""
    kinds = torch.float32, torch.float64
    is_light = isinstance(pictures, Tensor) and pictures.dtype in kinds
    requirement = "be a tensor of 32 or 64 bits"
    require(is_light, subject, requirement, getattr(pictures, "dtype", pictures))
    has_pixels = pictures.ndim >= 2 and 0 not in pictures.shape[-2:]
    require(has_pixels, subject, "have rows and columns", shape_of(pictures))
    return pictures if scene.sensor.axis == "rows" else pictures.mT


def _filtered(rows: Tensor, response: Tensor) -> Tensor:
    """Periodic rows through a response on the grid of their DFT."""
    if not rows.numel():  # PyTorch transforms no empty batch
        return rows
    return torch.fft.irfft(torch.fft.rfft(rows) * response, rows.shape[-1])


def _complex_of(like: Tensor) -> torch.dtype:
    return torch.complex64 if like.dtype == torch.float32 else torch.complex128
