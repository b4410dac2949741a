r"""Skips that change a result a little: each is tried at the design at hand and measured.

What a skip would do is found without compiling anything for it: frequencies and taps that it
drops are set to zero, speeds that it drops keep their place without weight. The bound of a
skip is twice the change that it was measured to make, and only a skip whose bound is within
its share of the tolerance is taken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.compiling import quick_to_compile
from mishutter.lengths import size_class
from mishutter.losses.base import AbstractLoss, AbstractResponseLoss, WeightedSum
from mishutter.metrics import measured
from mishutter.motion import AbstractMotion, StillCamera
from mishutter.plan import Item, Plan, reduced
from mishutter.plan_check import everything, relative_change, results, results_of, rounding
from mishutter.response import Records, assembled, records
from mishutter.scene import Scene
from mishutter.shutters.base import AbstractShutter
from mishutter.speeds import distinct_speeds, quadrature
from mishutter.types import common_dtype

_NUM_SKIPS = 4
_SAFETY = 2.0
_LEAST_COUNT = 16
_SINGLE = 1e-6
"""Relative error of kernels and transfer functions in single precision."""


@dataclass
class Probe:
    """Results of one design under a plan that is made smaller step by step.

    Attributes:
        plan: The plan as far as it got.
        scene: What it is for, as the next four.
        items: The skips that were taken.
    """

    plan: Plan
    scene: Scene
    motion: AbstractMotion
    shutter: AbstractShutter
    loss: AbstractLoss | None
    items: dict[str, Item]

    def __post_init__(self) -> None:
        self._given = self.plan
        self._rounding = rounding(self.scene, self.motion, self.shutter)
        self._share = self.plan.tolerance / _NUM_SKIPS
        case = self.scene, self.motion, self.shutter, self.loss
        self._full = results(everything(self.plan, self.scene, self.motion), *case)
        self._now = results(self.plan, *case)
        self._terms = response_terms(self.loss)
        self._recorded: dict[int | None, tuple[Scene, Records]] = {}

    def take(self, name: str, kept: str, why: str, **smaller: object) -> bool:
        """Take a skip if the change that it makes is within its share."""
        tried = replace(self.plan, **smaller)  # type: ignore[arg-type]
        value = self._value(tried)
        bound = _SAFETY * relative_change(value, self._now, self._full) + self._rounding
        if not bound <= self._share:
            return False
        self.plan, self._now = tried, value
        before = self.items[name]
        self.items[name] = replace(before, kept=kept, why=why, bound=bound)
        return True

    def _value(self, tried: Plan) -> np.ndarray:
        if tried.single or self._terms is None:
            return results(tried, self.scene, self.motion, self.shutter, self.loss)
        kept, recorded = self._records(tried.num_speeds)
        num_kept = tried.num_kept or tried.num_frequencies
        limits = jnp.asarray([tried.num_taps, num_kept])
        masked = _masked(recorded, limits)
        if self.loss is None:
            return results_of(measured(kept, self.motion, masked, self._given))
        return np.array([float(_loss(self._terms, kept, self.motion, masked, self._given))])

    def _records(self, num_speeds: int | None) -> tuple[Scene, Records]:
        """Records of the first plan's shapes, with fewer speeds that have weight."""
        if num_speeds not in self._recorded:
            kept = reduced(self.scene, self._given)
            if num_speeds is not None:
                speeds, weights = distinct_speeds(self.scene, folds=self._given.folds)
                speeds, weights = quadrature(speeds, weights, num_speeds)
                spare = kept.speeds.size - speeds.size
                speeds = np.pad(speeds, (0, spare), mode="edge")
                kept = kept.bare(speeds=speeds, weights=np.pad(weights, (0, spare)))
            recorded = records(kept, self.motion, self.shutter, self._given)
            self._recorded[num_speeds] = kept, recorded
        return self._recorded[num_speeds]


def response_terms(
    loss: AbstractLoss | None,
) -> tuple[tuple[AbstractResponseLoss, float], ...] | None:
    """Terms of a loss that is made from responses; None for another, none for metrics."""
    if loss is None:
        return ()
    given = loss.needed(skips=True) if isinstance(loss, WeightedSum) else [(loss, 1.0)]
    terms = [(term, weight) for term, weight in given if isinstance(term, AbstractResponseLoss)]
    return tuple(terms) if len(terms) == len(given) else None


def toleranced(
    exact: Plan,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    loss: AbstractLoss | None,
    *,
    fewer_frequencies: bool,
    fewer_taps: bool,
    fewer_speeds: bool,
    single: bool,
) -> Plan:
    """An exact plan with the skips that its tolerance allows.

    Args:
        exact: The plan to make smaller, with its tolerance.
        scene: Speeds, light and noise.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        loss: What the plan is for; all metrics without one.
        fewer_frequencies: Whether to drop frequencies that the noise drowns.
        fewer_taps: Whether to drop taps that hardly any light falls on.
        fewer_speeds: Whether to let a few speeds stand for all.
        single: Whether to try single precision.
    """
    named = {item.name: item for item in exact.items}
    probe = Probe(exact, scene, motion, shutter, loss, named)
    if fewer_frequencies:
        _fewer_frequencies(probe)
    if fewer_taps and not isinstance(motion, StillCamera):
        _fewer_taps(probe)
    if fewer_speeds:
        _fewer_speeds(probe)
    wide = common_dtype(*jax.tree.leaves((scene.speeds, motion, shutter))).itemsize > 4
    if single and wide and exact.tolerance / _NUM_SKIPS > _SAFETY * _SINGLE:
        why = "its rounding was measured to be within the tolerance"
        probe.take("precision", "float32", why, single=True)
    return replace(probe.plan, items=tuple(probe.items.values()))


def _fewer_frequencies(probe: Probe) -> None:
    why = "the noise drowns the picture above"
    count = probe.plan.num_kept or probe.plan.num_frequencies
    for fewer in _smaller(count):
        if not probe.take("frequencies", str(fewer), why, num_kept=fewer):
            return


def _fewer_taps(probe: Probe) -> None:
    why = "hardly any light falls beyond"
    for fewer in _smaller(probe.plan.num_taps):
        if not probe.take("taps", str(fewer), why, num_taps=fewer):
            return


def _fewer_speeds(probe: Probe) -> None:
    why = "a Gauss rule of the speeds stands for them"
    count = distinct_speeds(probe.scene, folds=probe.plan.folds)[0].size
    fewer = 1
    while fewer < count and size_class(count) > fewer:
        if probe.take("speeds", str(fewer), why, num_speeds=fewer):
            return
        fewer = size_class(fewer + 1)


def _smaller(count: int) -> list[int]:
    """Size classes below a count, from the largest down to 16."""
    sizes = {size_class(number) for number in range(_LEAST_COUNT, count)}
    return sorted((size for size in sizes if size < count), reverse=True)


def _masked(recorded: Records, limits: Array) -> Records:
    """Records without the taps and frequencies beyond their limits, in the same shapes."""
    taps, waves = (jnp.arange(part.shape[-1]) for part in (recorded.kernels, recorded.spectra))
    return recorded._replace(
        kernels=jnp.where((taps < limits[0])[None], recorded.kernels, 0),
        spectra=jnp.where((waves < limits[1])[None], recorded.spectra, 0),
    )


@quick_to_compile
def _loss(
    terms: tuple[tuple[AbstractResponseLoss, float], ...],
    scene: Scene,
    motion: AbstractMotion,
    recorded: Records,
    plan: Plan,
) -> Array:
    plan = replace(plan, num_kept=None)
    response = assembled(scene, recorded, plan)
    each = [weight * loss.of_response(scene, motion, response, plan) for loss, weight in terms]
    return sum(each[1:], start=each[0])
