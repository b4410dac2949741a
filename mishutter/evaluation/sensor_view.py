"""The door to every response: a scene, a motion and a shutter as the sensor sees them.

Metrics, losses, decoders and captures begin here, and nothing below asks again in which frame
speeds are, whether a motion bends, or whether a profile has been through the device.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mishutter._core import all_concrete, primal_values
from mishutter.blur import support
from mishutter.evaluation.lengths import most_spread, spread_of_traced
from mishutter.evaluation.needs import (
    Automatic,
    Parts,
    Plan,
    automatic,
    plan_of_traced_search,
    reduced,
    require_plan,
    sizes,
    velocity_held,
)
from mishutter.model import (
    AbstractMotion,
    AbstractPiecewiseShutter,
    AbstractShutter,
    Scene,
    canonical_motion,
    piecewise,
    seen_from,
)


class SensorView(NamedTuple):
    """A scene and a design in the frame that pans with the sensor.

    Attributes:
        scene: The scene, with its speeds relative to the sensor.
        motion: The motion without velocity, in its `canonical_motion`.
        shutter: Transmittance behind the scene's device.
        velocity: Velocity of the sensor, which is taken from all speeds; px/s, scalar.
    """

    scene: Scene
    motion: AbstractMotion
    shutter: AbstractShutter
    velocity: Array


class SampledView(NamedTuple):
    """What a response is computed from; `respond` makes one of it.

    Attributes:
        scene: Speeds relative to the sensor, those that the plan keeps; no picture, no motion.
        motion: The motion without velocity, in its `canonical_motion`.
        shutter: Transmittance behind the scene's device, as pieces.
        plan: Taps, frequencies and quadrature nodes.
        parts: Parts of the response that are wanted.
    """

    scene: Scene
    motion: AbstractMotion
    shutter: AbstractPiecewiseShutter
    plan: Plan
    parts: Parts


def sensor_view(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> SensorView:
    """A scene and a design as the sensor sees them.

    Raises:
        ValueError: if the scene is none, or the motion.
    """
    canonical = canonical_motion(motion)
    seen, still = seen_from(scene, canonical)
    return SensorView(seen, still, scene.light(shutter, motion), canonical.velocity)


def transmittance(
    scene: Scene, motion: AbstractMotion | ArrayLike, shutter: AbstractShutter
) -> AbstractPiecewiseShutter:
    """Transmittance behind a scene's device, as pieces; arguments as those of `Scene.light`."""
    return piecewise(scene.light(shutter, motion))


def sampled_view(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    plan: Plan | Automatic | None,
    parts: Parts | Callable[[Plan], Parts],
) -> SampledView:
    """A scene and a design as the sensor sees them, in the sizes that their response takes.

    A motion that is traced is refused, when it is run, if a plan made here has too few taps, nodes
    or frequencies for those parts of its response that are used.

    Args:
        scene: The scene.
        motion: Motion of the sensor.
        shutter: The profile, or the transmittance that a device has made of one.
        plan: A plan, or the argument `plan=` that stands for one.
        parts: Parts of the response that are wanted, which may depend on the plan.

    Raises:
        ValueError: if the scene is none, or the motion, or the plan.
    """
    require_plan(plan)
    view = sensor_view(scene, motion, shutter)
    chosen, still = plan, view.motion
    if not isinstance(chosen, Plan):
        everything = chosen is None
        chosen = sizes(view.scene, still) if everything else automatic(view.scene, still, shutter)
    wanted = parts if isinstance(parts, Parts) else parts(chosen)
    if not isinstance(plan, Plan) and not all_concrete(primal_values((view.scene.speeds, still))):
        still = _refused_beyond(chosen, view.scene, still, wanted)
    return SampledView(reduced(view.scene, chosen), still, piecewise(view.shutter), chosen, wanted)


def _refused_beyond(
    plan: Plan, scene: Scene, motion: AbstractMotion, parts: Parts
) -> AbstractMotion:
    """A motion that is traced, an error where it exceeds the sizes of a plan."""
    fastest = scene.max_speed
    if parts.kernels:
        reach = support(motion, fastest if parts.differences else jnp.zeros_like(fastest))
        requirement = f"keep light within {plan.num_taps} px of where it is aligned"
        motion = _refused(motion, reach > plan.num_taps, requirement)
    if parts.spectra:
        velocity = (motion.speed_gain + fastest) * motion.half_exposure
        most = velocity_held(plan.num_nodes)
        requirement = f"be passed at no more than {most} px per half exposure"
        motion = _refused(motion, velocity > most, requirement)
        # A search is rough where it may be, on fewer frequencies than hold all light.
        if plan_of_traced_search.value is None:
            furthest = most_spread(plan.num_frequencies)
            requirement = f"spread light over at most {furthest:.0f} px"
            motion = _refused(motion, spread_of_traced(scene, motion) > furthest, requirement)
    return motion


def _refused(motion: AbstractMotion, exceeds: ArrayLike, requirement: str) -> AbstractMotion:
    """The motion, which is an error, when it is run, where it `exceeds` a requirement."""
    where = "where it or the scene's limits are traced"
    message = f"`motion` must {requirement} {where}; got one that exceeds it."
    # Threads the error on a number of its own: the branches that return the motion itself would
    # differ in how they vary over the devices of a mesh.
    nothing = eqx.error_if(jnp.zeros(()), exceeds, message)
    return jax.tree.map(lambda x: x + nothing.astype(x.dtype), motion)
