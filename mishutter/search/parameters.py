"""Designs by numbers without bounds, for optimisers of one's own."""

from collections.abc import Callable, Iterable
from typing import final

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from mishutter._core.checks import (
    RowLike,
    as_float,
    require,
    require_known,
    row_of,
)
from mishutter._core.modules import AbstractModule
from mishutter.evaluation.losses import LossFunction, as_loss
from mishutter.evaluation.speed_knowledge import loss_of_decoder
from mishutter.evaluation.views import nan_unless_defined
from mishutter.model.devices import command_of
from mishutter.model.motion import AbstractMotion, is_known_zero, simplified
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter, num_coordinates
from mishutter.search.objective import objective_of
from mishutter.search.planning import plan
from mishutter.search.search import starting_shutter
from mishutter.search.space import DesignSpace, all_that_can_move, design_space, search_frame

_NEAREST = 1e-3
"""Least distance of a design from the ends of its coordinates, where the logistic function is flat:
steps of 0.1 in a number lead away from there in some fifty."""


@final
class DesignParameters(AbstractModule):
    r"""Designs within a scene's limits, as a function of real numbers without bounds.

    They are the search's unit box of designs, each coordinate of which is $1/(1 + e^{-z})$ of one
    number $z$: the profile's coefficients, and half exposure, velocity and acceleration between the
    bounds that stroke, top speed, exposure, pan and stage leave them, each by those before it. An
    optimiser that knows no bounds (optax, jaxopt, optimistix, PyTorch) so moves designs that can be
    built. Designs keep up with as many objects as in `optimise`. Its methods work under `jax.jit`,
    `jax.grad` and `jax.vmap`.

    Args:
        scene: Limits, speeds and device.
        motion: Motion whose numbers stay where they are not free; the scene's by default.
        shutter: Profile of the kind that moves, as it is sent to the scene's device; the
            `starting_shutter` of the scene by default.
        free: Parts that move, as in `optimise`: `"shutter"`, `"path"`, `"half_exposure"`,
            `"velocity"`, `"acceleration"`; all that can but the path by default.

    Attributes:
        scene: The scene, in the frame of the motion where the velocity is not free.
        space: The box.
        velocity: Velocity at mid-exposure of motions whose velocity is not free; px/s.
        start: The numbers of the motion and the shutter that were given; shape `(size,)`.

    Raises:
        ValueError: if `free` names nothing or what cannot move, or if JAX traces an argument.

    Examples:
        >>> import jax.numpy as jnp
        >>> from mishutter import DesignParameters, Limits, Scene, TukeyShutter
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> parameters = DesignParameters(scene, shutter=TukeyShutter(0.5))
        >>> motion, shutter = parameters.design(jnp.array([0.3, 40.0, 70.0, 0.1]))
        >>> print(f"{motion.stroke:.2f} px, taper {shutter.taper:.3f}")
        20.00 px, taper 0.574
        >>> print(f"{parameters.loss()(parameters.start):.3f}")
        0.364
    """

    scene: Scene
    space: DesignSpace
    velocity: Array
    start: Float[Array, "size"]

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotion | None = None,
        shutter: AbstractShutter | None = None,
        *,
        free: str | Iterable[str] | None = None,
    ):
        require_scene(scene)
        require_known("DesignParameters", scene=scene, motion=motion, shutter=shutter)
        motion = scene.motion if motion is None else motion
        is_motion = isinstance(motion, AbstractMotion)
        require(is_motion, "DesignParameters(motion=...)", "be a motion", motion)
        command = starting_shutter(scene) if shutter is None else command_of(shutter)
        if free is None:
            names = all_that_can_move(scene, motion, command)
        else:
            names = (free,) if isinstance(free, str) else tuple(free)
        self.scene, moving = search_frame(scene, motion, names)
        self.space = design_space(self.scene, moving, command, names, function="DesignParameters")
        self.velocity = motion.velocity
        self.start = self.numbers(motion, command)

    @property
    def size(self) -> int:
        """Number of numbers."""
        return self.space.size

    def design(self, numbers: RowLike) -> tuple[AbstractMotion, AbstractShutter]:
        """The motion and the shutter of some numbers, as losses take them after the scene.

        The shutter is the transmittance behind the scene's device.

        Args:
            numbers: Numbers from the whole line; shape `(size,)`.

        Raises:
            ValueError: if they are of another shape, or known and not finite.
        """
        row = row_of("DesignParameters.design(numbers=...)", numbers, self.size)
        shutter, motion = self.space.at(jax.nn.sigmoid(row))
        if self._pans_as_it_did:
            motion = motion.panned(self.velocity)
        return motion, shutter

    def numbers(self, motion: AbstractMotion, shutter: AbstractShutter) -> Float[Array, "size"]:
        """The numbers of the design that is nearest to a motion and a shutter, by `design`.

        Coordinates of the box are kept within 0.001 and 0.999, since 0 and 1 are infinitely far.

        Args:
            motion: Motion of the sensor.
            shutter: Profile of the kind that moves; what does not move is not looked at.

        Raises:
            ValueError: if the shutter is of another kind, or of another number of coefficients.
        """
        command, own = command_of(shutter), self.space.shutter
        if "shutter" in self.space.free:
            count = self.space.num_profile_coordinates
            is_alike = isinstance(command, type(own)) and num_coordinates(command) == count
            requirement = f"be a {type(own).__name__} with {count} numbers that move"
            require(is_alike, "DesignParameters.numbers(shutter=...)", requirement, command)
        motion = simplified(motion)
        moving = motion.without_velocity() if self._pans_as_it_did else motion
        point = jnp.clip(self.space.point_of(command, moving), _NEAREST, 1 - _NEAREST)
        return nan_unless_defined(jnp.log(point) - jnp.log1p(-point), motion, command)

    def loss(self, loss: LossFunction | None = None) -> Callable[[RowLike], Float[Array, ""]]:
        """A loss as a function of the numbers: what `optimise` minimises, in the same time.

        Called by itself, a loss of traced numbers computes with sizes that hold the motions which
        keep up with the objects, and ends with an error where others of the box spread light
        further. This function has sizes for the whole box.

        Args:
            loss: The loss, or a function of scene, motion and shutter; by default the expected
                error of the decoder that the scene names.

        Returns:
            A function of numbers of shape `(size,)`, to be differentiated and compiled.
        """
        chosen = loss_of_decoder(self.scene) if loss is None else loss
        chosen = as_loss(chosen, "DesignParameters.loss(loss=...)")
        start, space = (self.space.motion, self.space.shutter), self.space
        sizes = plan(self.scene, *start, loss=chosen, free=space.free).sizes
        objective = objective_of(chosen, self.scene, space, sizes)
        return lambda numbers: objective(jax.nn.sigmoid(as_float(numbers)))

    @property
    def _pans_as_it_did(self) -> bool:
        """Whether the velocity is fixed, so that the box is of motions in a frame that pans."""
        return "velocity" not in self.space.free and not is_known_zero(self.velocity)
