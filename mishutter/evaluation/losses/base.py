"""The interface of losses, and sums of losses."""

import inspect
from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import compiled, require
from mishutter.evaluation.needs import PLANNED, Automatic, Parts, Plan, chosen, reduced
from mishutter.evaluation.response import Response, respond
from mishutter.model import AbstractMotion, AbstractShutter, Scene


class AbstractLoss(eqx.Module):
    """A scalar to be made small: `loss(scene, motion, shutter, plan=...)`.

    A loss of your own is a function of scene, motion and shutter, or a small class with such
    a `__call__`, which takes `plan` if it has a use for it. Losses add and subtract, also by
    `sum`, and take factors: `ExpectedErrorLoss() + 0.1 * DesignLoss()`.
    """

    @property
    def sees_light(self) -> bool:
        """Whether the loss knows how much light an exposure brings.

        One that does not is least at the shortest exposure: by default it moves profiles alone.
        """
        return True

    @abstractmethod
    def __call__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        shutter: AbstractShutter,
        *,
        plan: Plan | Automatic | None = PLANNED,
    ) -> Array:
        """The loss; scalar. By default a plan is made for the scene; None computes everything."""

    def __add__(self, other: "AbstractLoss") -> "AbstractLoss":
        if not isinstance(other, AbstractLoss):
            return NotImplemented
        terms = [term for loss in (self, other) for term in _terms(loss)]
        return WeightedSum(tuple(t[0] for t in terms), tuple(t[1] for t in terms))

    def __radd__(self, other: Any) -> "AbstractLoss":
        """0 plus a loss is the loss: `sum` begins with 0."""
        return self if isinstance(other, int) and other == 0 else NotImplemented

    def __neg__(self) -> "AbstractLoss":
        return -1.0 * self

    def __sub__(self, other: Any) -> "AbstractLoss":
        return self + -other if isinstance(other, AbstractLoss) else NotImplemented

    def __mul__(self, factor: Any) -> "AbstractLoss":
        if not _is_number(factor):
            return NotImplemented
        terms = _terms(self)
        return WeightedSum(tuple(t[0] for t in terms), tuple(factor * t[1] for t in terms))

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> "AbstractLoss":
        return self * (1 / divisor) if _is_number(divisor) else NotImplemented


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number | jax.Array) and np.ndim(value) == 0


def value_of(
    loss: AbstractLoss,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    plan: Plan | Automatic | None,
) -> Array:
    """The value of a loss, which may be a user's; scalar.

    Raises:
        ValueError: if it is not one real number.
    """
    given = {"plan": plan} if _takes_plan(type(loss)) else {}
    return one_real_number(loss, loss(scene, motion, shutter, **given))


@lru_cache
def _takes_plan(kind: type[AbstractLoss]) -> bool:
    parameters = inspect.signature(kind.__call__).parameters.values()
    return any(p.name == "plan" or p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters)


def one_real_number(loss: AbstractLoss, value: Any) -> Array:
    """The value of a loss; scalar.

    Raises:
        ValueError: if it is not one real number.
    """
    is_array = isinstance(value, jax.Array | np.ndarray)
    got = f"{value.dtype} of shape {value.shape}" if is_array else type(value).__name__
    is_one = (is_array or _is_number(value)) and np.shape(value) == () and jnp.isrealobj(value)
    require(is_one, f"{type(loss).__name__}.__call__", "give one real number", got)
    return jnp.asarray(value)


class AbstractResponseLoss(AbstractLoss):
    """A loss that depends on the shutter through its response alone.

    A response is kernels, transfer functions and efficiency, all linear in the transmittance: a
    search computes the responses of basis profiles once and adds them up at each step.
    """

    @abstractmethod
    def parts(self, plan: Plan) -> Parts:
        """Parts of the response that the loss needs; without skips also those of no weight."""

    @abstractmethod
    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, plan: Plan
    ) -> Array:
        """The loss of a response; scalar."""

    def __call__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        shutter: AbstractShutter,
        *,
        plan: Plan | Automatic | None = PLANNED,
    ) -> Array:
        plan, scene, motion = chosen(plan, scene, motion, shutter, self.parts)
        kept = reduced(scene, plan)
        response = respond(kept, motion, shutter, plan, **self.parts(plan)._asdict())
        return _of_response(self, kept, motion, response, plan)


@compiled
def _of_response(
    loss: AbstractResponseLoss, scene: Scene, motion: AbstractMotion, response: Response, plan: Plan
) -> Array:
    return loss.of_response(scene, motion, response, plan)


@final
class FunctionLoss(AbstractLoss):
    """A loss that is a plain function of scene, motion and shutter."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        shutter: AbstractShutter,
        *,
        plan: Plan | Automatic | None = PLANNED,
    ) -> Array:
        return self.function(scene, motion, shutter)

    def __repr__(self) -> str:
        function = self.function if hasattr(self.function, "__qualname__") else type(self.function)
        return f"{function.__module__}.{function.__qualname__}"


def as_loss(loss: AbstractLoss | Callable[..., Any], subject: str) -> AbstractLoss:
    """A loss, which may be given as a function.

    Raises:
        ValueError: if it is neither.
    """
    function = callable(loss) and not isinstance(loss, type)
    require(function, subject, "be a loss or a function of scene, motion and shutter", loss)
    return loss if isinstance(loss, AbstractLoss) else FunctionLoss(loss)


@final
class WeightedSum(AbstractLoss):
    """Weighted sum of losses; what `+` and `*` build."""

    losses: tuple[AbstractLoss, ...]
    weights: tuple[float, ...]

    def __call__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        shutter: AbstractShutter,
        *,
        plan: Plan | Automatic | None = PLANNED,
    ) -> Array:
        terms = [
            weight * value_of(loss, scene, motion, shutter, plan)
            for loss, weight in self.needed(skips=plan is not None)
        ]
        return sum(terms, start=jnp.zeros_like(terms[0]))

    @property
    def sees_light(self) -> bool:
        return any(loss.sees_light for loss, _ in self.needed(skips=True))

    def needed(self, *, skips: bool) -> list[tuple[AbstractLoss, float]]:
        """Terms with their weights; `skips` drops terms of weight 0, but never the last."""
        terms = list(zip(self.losses, self.weights, strict=True))
        weighty = [
            term for term in terms if not (isinstance(term[1], float | int) and term[1] == 0)
        ]
        return (weighty or terms[:1]) if skips else terms


def _terms(loss: AbstractLoss) -> list[tuple[AbstractLoss, float]]:
    if isinstance(loss, WeightedSum):
        return list(zip(loss.losses, loss.weights, strict=True))
    return [(loss, 1.0)]
