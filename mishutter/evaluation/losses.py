"""Losses that a search minimises: their interface, their sums, and `DesignLoss`.

The expected errors of decoders stand beside what those know of the speed, in `speed_knowledge`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, TypeGuard, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.checks import is_concrete, require
from mishutter._core.compiling import compiled
from mishutter._core.modules import AbstractModule
from mishutter.evaluation.metrics import kernel_differences
from mishutter.evaluation.needs import Parts, Plan
from mishutter.evaluation.response import Response, compute_response
from mishutter.evaluation.views import nan_unless_defined, sampled_view
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter

Factor = int | float | np.number | jax.Array
"""A number that a loss may be multiplied by; an array is a scalar."""
LossFunction = Callable[[Scene, AbstractMotion, AbstractShutter], object]
"""A loss, or a function of scene, motion and shutter that gives one real number."""
_SHARPNESS = 200


class AbstractLoss(AbstractModule):
    """A scalar to minimise: `loss(scene, motion, shutter)`.

    A loss of your own is a function of scene, motion and shutter, or a small class with such
    a `__call__`. Losses add and subtract, also by `sum`, and take factors:
    `ExpectedErrorLoss() + 0.1 * DesignLoss()`.

    Attributes:
        decoder_speed: Knowledge of the speed that the decoder has whose expected error it is; None
            for other losses.
        of_worst_speed: Whether the error is that at the worst speed, and not the mean over speeds.
    """

    decoder_speed: ClassVar[DecoderSpeed | None] = None
    of_worst_speed: ClassVar[bool] = False

    @property
    def sees_light(self) -> bool:
        """Whether the loss depends on how much light an exposure brings.

        A loss that does not is least at the shortest exposure: by default it moves profiles alone.
        """
        return True

    @abstractmethod
    def __call__(
        self, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
    ) -> Float[Array, ""]:
        """A number to be made small: real, scalar, and differentiable by the design's numbers.

        Args:
            scene: Speeds, light, noise and limits.
            motion: Motion of the sensor.
            shutter: The profile, or the transmittance that the scene's device makes of it.
        """

    def __add__(self, other: "AbstractLoss") -> "AbstractLoss":
        if not isinstance(other, AbstractLoss):
            return NotImplemented
        terms = [term for loss in (self, other) for term in _terms(loss)]
        return WeightedSum(tuple(t[0] for t in terms), tuple(t[1] for t in terms))

    def __radd__(self, other: object) -> "AbstractLoss":
        """0 plus a loss is the loss: `sum` begins with 0."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __neg__(self) -> "AbstractLoss":
        return -1.0 * self

    def __sub__(self, other: object) -> "AbstractLoss":
        return self + -other if isinstance(other, AbstractLoss) else NotImplemented

    def __mul__(self, factor: object) -> "AbstractLoss":
        if not _is_number(factor):
            return NotImplemented
        terms = _terms(self)
        return WeightedSum(tuple(t[0] for t in terms), tuple(factor * t[1] for t in terms))

    __rmul__ = __mul__

    def __truediv__(self, divisor: object) -> "AbstractLoss":
        return self * (1 / divisor) if _is_number(divisor) else NotImplemented


def _is_number(value: object) -> TypeGuard[Factor]:
    return isinstance(value, Factor) and np.ndim(value) == 0


def value_of(
    loss: AbstractLoss,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    plan: Plan | None = None,
) -> Float[Array, ""]:
    """The value of a loss, which may be a user's, by the plan of a search if there is one.

    The one road by which a search hands its plan to the losses: called by a user, each makes its
    own.
    """
    if isinstance(loss, WeightedSum):
        values = [w * value_of(part, scene, motion, shutter, plan) for part, w in loss.needed]
        value = sum(values, start=jnp.zeros_like(values[0]))
    elif isinstance(loss, AbstractResponseLoss):
        view = sampled_view(scene, motion, shutter, loss.parts, plan)
        count = view.plan.num_frequencies
        value = _of_response(loss, view.scene, view.motion, compute_response(view), count)
        value = nan_unless_defined(value, motion, shutter, scene)
    else:
        value = loss(scene, motion, shutter)
    return one_real_number(loss, value)


def one_real_number(loss: AbstractLoss, value: object) -> Float[Array, ""]:
    """The value of a loss, which may be a user's, refused if it is not one real number."""
    if isinstance(value, jax.Array | np.ndarray):
        is_scalar, got = value.shape == (), f"{value.dtype} of shape {value.shape}"
    else:
        is_scalar, got = _is_number(value), type(value).__name__
    is_one = is_scalar and jnp.isrealobj(value)
    require(is_one, f"{type(loss).__name__}.__call__", "give one real number", got)
    return jnp.asarray(value)


class AbstractResponseLoss(AbstractLoss):
    """A loss that depends on the shutter through its response alone, and so is fast to search by.

    Kernels, transfer functions and efficiency are all linear in the transmittance: a search
    computes the responses of basis profiles once and adds them up at each step. A subclass says
    which parts of the response it reads, and its value for one response; `__call__` is made of
    these.
    """

    @property
    @abstractmethod
    def parts(self) -> Parts:
        """Parts of the response that the loss reads; others may be empty or of other sizes."""

    @abstractmethod
    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        """A number to be made small, of one response: real, scalar and differentiable by it.

        It is traced, so that it may not ask for the values of the response's numbers.

        Args:
            scene: Speeds, light and noise in the frame of the sensor: each speed once, and those
                that mirror one another only once where the shutter is symmetric.
            motion: Motion of the sensor, without velocity.
            response: Efficiency, kernels and transfer functions, linear in the transmittance.
            num_frequencies: Frequencies in (0, 0.5) cycles/px of the grid that transfer functions
                stand on; they are the lowest of these, and the picture has no power at others.
        """

    def __call__(
        self, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
    ) -> Float[Array, ""]:
        return value_of(self, scene, motion, shutter)


@compiled
def _of_response(
    loss: AbstractResponseLoss,
    scene: Scene,
    motion: AbstractMotion,
    response: Response,
    num_frequencies: int,
) -> Float[Array, ""]:
    return loss.of_response(scene, motion, response, num_frequencies)


@final
class FunctionLoss(AbstractLoss):
    """A loss that is a plain function of scene, motion and shutter."""

    function: LossFunction = eqx.field(static=True)

    def __call__(
        self, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
    ) -> Float[Array, ""]:
        return one_real_number(self, self.function(scene, motion, shutter))

    def __repr__(self) -> str:
        function = self.function if hasattr(self.function, "__qualname__") else type(self.function)
        return f"{function.__module__}.{function.__qualname__}"


def as_loss(loss: LossFunction, subject: str) -> AbstractLoss:
    """A loss, or a function as a loss; anything else is refused."""
    is_function = callable(loss) and not isinstance(loss, type)
    require(is_function, subject, "be a loss or a function of scene, motion and shutter", loss)
    return loss if isinstance(loss, AbstractLoss) else FunctionLoss(loss)


@final
class WeightedSum(AbstractLoss):
    """Weighted sum of losses, which `+` and `*` build."""

    losses: tuple[AbstractLoss, ...]
    weights: tuple[Factor, ...]

    def __call__(
        self, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
    ) -> Float[Array, ""]:
        return value_of(self, scene, motion, shutter)

    @property
    def sees_light(self) -> bool:
        return any(loss.sees_light for loss, _ in self.needed)

    @property
    def needed(self) -> list[tuple[AbstractLoss, Factor]]:
        """Terms with their weights, without those of weight 0, but never without the last."""
        terms = list(zip(self.losses, self.weights, strict=True))
        weighty = [
            term for term in terms if not (isinstance(term[1], float | int) and term[1] == 0)
        ]
        return weighty or terms[:1]


def _terms(loss: AbstractLoss) -> list[tuple[AbstractLoss, Factor]]:
    if isinstance(loss, WeightedSum):
        return list(zip(loss.losses, loss.weights, strict=True))
    return [(loss, 1.0)]


def _plain(weight: object) -> Any:
    """The number in a scalar array that is concrete; other weights as they are."""
    is_array = isinstance(weight, np.ndarray | np.generic | jax.Array)
    return weight.item() if is_array and weight.ndim == 0 and is_concrete(weight) else weight


@final
class DesignLoss(AbstractResponseLoss):
    r"""$w_1\,\tilde\kappa + w_2\,\Delta + w_3\,(1 - \eta)$.

    $\tilde\kappa$ is the condition number of the still object's kernel with its maximum
    and minimum smoothed, $\Delta$ the relative cross-speed kernel difference and $\eta$
    the efficiency. All are dimensionless; dimming the shutter does not change the first two
    and raises the third, so closing it gains nothing.

    With $P_f = |H(f)|^2$ over $F$ DFT frequencies and $\beta = 200$,
    $\tilde\kappa^2 = (\sum P_f^\beta)^{1/\beta} (\sum P_f^{-\beta})^{1/\beta}$, hence
    $\kappa \le \tilde\kappa \le F^{1/\beta}\kappa$: at most 2.5 % too large for 129
    frequencies. The DFT has the length of the longest kernel within the scene's limits, whatever
    the motion: a longer kernel is folded onto it. A spectral zero counts as
    $|H| = \varepsilon\max|H|$, the working precision.

    It ignores light and noise: for a camera at rest it is least at the shortest exposure. A search
    by it moves the profile alone by default, on a motion that the expected error chooses.

    Args:
        condition: $w_1$, at least 0; a number, not an array that is traced.
        invariance: $w_2$, at least 0.
        efficiency: $w_3$, at least 0.

    Raises:
        ValueError: if a weight is negative or not finite.
    """

    condition: float = eqx.field(default=0.1, converter=_plain)
    invariance: float = eqx.field(default=1.0, converter=_plain)
    efficiency: float = eqx.field(default=1.0, converter=_plain)

    def __check_init__(self) -> None:
        requirement = "be a finite plain number of at least 0"
        for name in ("condition", "invariance", "efficiency"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and 0 <= value < float("inf")
            require(number, f"DesignLoss({name}=...)", requirement, value)

    @property
    def sees_light(self) -> bool:
        return False

    @property
    def parts(self) -> Parts:
        differences = bool(self.invariance)
        kernels = differences or bool(self.condition)
        return Parts(kernels=kernels, spectra=False, differences=differences)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        loss = self.efficiency * (1 - response.efficiency)
        if self.condition:
            loss += self.condition * smooth_condition_number(response.still_spectrum)
        if self.invariance:
            loss += self.invariance * kernel_differences(scene, motion, response.squares)[1]
        return loss


def smooth_condition_number(spectrum: Complex[Array, "k"]) -> Float[Array, ""]:
    """Condition number with soft extremes; see `DesignLoss` for its bounds."""
    power = spectrum.real**2 + spectrum.imag**2
    largest = jax.lax.stop_gradient(jnp.max(power))
    some = largest > 0
    floor = jnp.finfo(power.dtype).eps ** 2
    share = jnp.where(some, power / jnp.where(some, largest, 1.0), 0) + floor
    least = jax.lax.stop_gradient(jnp.min(share))
    # Repeated squaring of numbers up to 1 is many times quicker than exponentials of logarithms.
    sums = jnp.sum(share**_SHARPNESS) * jnp.sum((least / share) ** _SHARPNESS)
    logarithm = jnp.log(sums) / _SHARPNESS - jnp.log(least)
    return jnp.where(some, jnp.exp(logarithm / 2), 1 / jnp.finfo(power.dtype).eps)
