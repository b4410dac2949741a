"""The door to every response: a scene, a motion and a shutter as the sensor sees them.

Metrics, losses, decoders and captures begin here. Nothing behind the door asks again in which
frame speeds are, whether a motion bends, or whether a profile has been through the device.
"""

from dataclasses import fields
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from mishutter._core.checks import all_concrete, is_concrete, primal_values, require_finite
from mishutter.blur.quadrature import ExposureQuadrature
from mishutter.evaluation.needs import Parts, Plan, automatic, plan_of_traced_search, reduced
from mishutter.model.motion import AbstractMotion, simplified
from mishutter.model.scene import Scene, in_sensor_frame, require_known_numbers
from mishutter.model.shutters.base import AbstractPiecewiseShutter, AbstractShutter, piecewise

_Values = TypeVar("_Values")


class SensorView(NamedTuple):
    """A scene and a design in the frame that pans with the sensor."""

    scene: Scene  # The scene, with its speeds relative to the sensor
    motion: AbstractMotion  # The motion without velocity, `simplified`
    shutter: AbstractShutter  # Transmittance behind the scene's device
    velocity: Float[Array, ""]  # Velocity of the sensor, subtracted from all speeds; px/s

    def sampled(
        self, plan: Plan, parts: Parts, nodes: ExposureQuadrature | None = None
    ) -> "SampledView":
        """The view of a `reduced` scene in the sizes of a plan, for which the caller answers."""
        return SampledView(self.scene, self.motion, piecewise(self.shutter), plan, parts, nodes)


class SampledView(NamedTuple):
    """A scene and a design in the frame of the sensor, and the sizes of their response."""

    scene: Scene  # The speeds that the plan keeps, relative to the sensor; no picture, no motion
    motion: AbstractMotion  # The motion without velocity, `simplified`
    shutter: AbstractPiecewiseShutter  # Transmittance behind the scene's device, as pieces
    plan: Plan  # Numbers of taps, frequencies and quadrature nodes
    parts: Parts  # Parts of the response to compute
    nodes: ExposureQuadrature | None = None  # Nodes of the shutter if a caller has them


def sensor_view(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> SensorView:
    """A scene and a design as the sensor sees them; numbers that are not finite are refused."""
    require_known_numbers(scene)
    require_numbers(motion)
    simple = simplified(motion)
    panned_scene, without_pan = in_sensor_frame(scene, simple)
    shutter = transmittance(scene, motion, shutter)
    return SensorView(panned_scene, without_pan, shutter, simple.velocity)


def transmittance(
    scene: Scene, motion: AbstractMotion | ArrayLike, shutter: AbstractShutter
) -> AbstractShutter:
    """Transmittance behind a scene's device; numbers that are not finite are refused."""
    require_numbers(shutter)
    return scene.light(shutter, motion)


def sampled_view(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    parts: Parts,
    plan: Plan | None = None,  # made here without one
) -> SampledView:
    """A scene and a design as the sensor sees them, in the sizes that their response takes.

    If the plan is made here for a traced motion, running it is an error where the motion needs more
    taps, nodes or frequencies than the plan has.
    """
    view = sensor_view(scene, motion, shutter)
    own_plan = automatic(view.scene, view.motion, shutter) if plan is None else plan
    own_plan.require_feasible(parts)
    is_traced = not all_concrete(primal_values((view.scene.speeds, view.motion)))
    if is_traced and plan is None:
        view = view._replace(motion=_refused_beyond(own_plan, view.scene, view.motion, parts))
    return view._replace(scene=reduced(view.scene, own_plan)).sampled(own_plan, parts)


def _refused_beyond(
    plan: Plan, scene: Scene, motion: AbstractMotion, parts: Parts
) -> AbstractMotion:
    """A traced motion, with a run-time error where it exceeds the sizes of a plan."""
    fastest = scene.max_speed
    if parts.kernels:
        reach = motion.kernel_length(fastest if parts.differences else jnp.zeros_like(fastest))
        requirement = f"keep light within {plan.num_taps} px of where it is aligned"
        motion = _refused(motion, reach > plan.num_taps, requirement)
    if parts.spectra:
        velocity = (motion.speed_gain + fastest) * motion.half_exposure
        requirement = f"be passed at no more than {plan.velocity_held} px per half exposure"
        motion = _refused(motion, velocity > plan.velocity_held, requirement)
        # A search takes fewer frequencies than hold all light, where its designs allow that.
        if plan_of_traced_search.value is None:
            requirement = f"spread light over at most {plan.spread_held:.0f} px"
            speeds = jnp.where(scene.weights > 0, scene.speeds, 0)
            spread = jnp.max(jnp.asarray(motion.highest(speeds) - motion.lowest(speeds)))
            motion = _refused(motion, spread > plan.spread_held, requirement)
    return motion


def _refused(
    motion: AbstractMotion, exceeds: Bool[Array | np.ndarray, ""], requirement: str
) -> AbstractMotion:
    """The motion, which is an error, when it is run, where it `exceeds` a requirement."""
    where = "where it or the scene's limits are traced"
    message = f"`motion` must {requirement} {where}; got one that exceeds it."
    # Threads the error on a number of its own: the branches that return the motion itself would
    # differ in how they vary over the devices of a mesh.
    nothing = eqx.error_if(jnp.zeros(()), exceeds, message)
    return jax.tree.map(lambda x: x + nothing.astype(x.dtype), motion)


def require_numbers(part: AbstractMotion | AbstractShutter) -> None:
    """Refuses known numbers that a function as `eqx.tree_at` has put into a motion or shutter."""
    if not isinstance(part, eqx.Module):
        return
    for field in fields(part):
        value = getattr(part, field.name)
        if isinstance(value, AbstractMotion | AbstractShutter):
            require_numbers(value)
        for leaf in filter(eqx.is_inexact_array, jax.tree.leaves(value)):
            require_finite(f"{type(part).__name__}({field.name}=...)", leaf)


def nan_unless_defined(
    values: _Values, motion: AbstractMotion, shutter: AbstractShutter, scene: Scene | None = None
) -> _Values:
    """Values of a design, or NaN where one of its traced numbers is none, or no time is exposed.

    A branch that a comparison with NaN chooses would else give a level, and the best of all. Known
    numbers are checked where the design enters. Limits of a scene may be infinite.
    """

    def traced(tree: object) -> list[Array]:
        return [x for x in jax.tree.leaves(tree) if not is_concrete(x) and eqx.is_inexact_array(x)]

    design, of_scene = traced((motion, shutter)), traced(scene)
    if not design and not of_scene:
        return values
    defined = jnp.asarray(motion.half_exposure > 0)
    for number in design:
        defined = defined & jnp.all(jnp.isfinite(number))
    for number in of_scene:
        defined = defined & ~jnp.any(jnp.isnan(number))
    return jax.tree.map(lambda x: jnp.where(defined, x, jnp.nan), values)
