r"""The level of exposures for a decoder that registers them, along an axis and in the plane.

A decoder that finds the velocity $\mathbf v$ of a picture in its exposures restores it from all of
them. Noise is independent from one to the other, and the error that is left is

$$E = \int S(\mathbf f)\,\overline{\frac{1}{1 + S P\sum_k e_k^2|H_k|^2/N_k}}\,d\mathbf f,
\qquad
H_k = \frac1{D_k}\int e^{-2\pi i\,\mathbf f\cdot(\mathbf x_k(t) - \mathbf v\,t)}\,dt,$$

in the mean over velocities, with $e_k$ electrons of white, $N_k = \bar f e_k + \sigma^2$ and
$P = \operatorname{sinc}^2 f_x\operatorname{sinc}^2 f_y$ behind the lens. Exposures of any path and
length may be mixed. Only $|H_k|$ counts: the direction of a parabola, its place and the gaps
between exposures do not matter.

Of a picture before a background the decoder knows the speed of both layers and which part is which,
and each part is restored by the filter of its speed: the error is the mean over the parts, and what
edges cost, of `mishutter.evaluation.strips`.

NumPy computes known numbers, so that a search compiles nothing; JAX computes traced ones, with
derivatives by all of them.
"""

import math
from contextlib import nullcontext
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import (
    Numbers,
    all_concrete,
    as_float,
    as_numpy,
    common_dtype,
    namespace_of,
    primal_values,
    require,
)
from mishutter._core.compiling import compiled, outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.fans import MEASURED, Fan, Grid
from mishutter.evaluation.instants import NODES, PX_A_PANEL, Instants
from mishutter.evaluation.layers import Background
from mishutter.evaluation.needs import distinct_speeds
from mishutter.evaluation.strips import Strips
from mishutter.model.exposures import Exposures, frames_of, open_frames, path_for_rows
from mishutter.model.frame_path import AT_REST, Frames, Lights, frames_in
from mishutter.model.optics import pixel_response
from mishutter.model.scene import Scene, require_one_axis, require_scene
from mishutter.model.sensor import noise_of_frames
from mishutter.model.velocities import Components

ROWS = np.stack(np.polynomial.legendre.leggauss(5)) / 2
"""Rows that stand for all of those that are exposed one after another: their delays, over the time
from the first row to the last, and the share of each."""
_AT_ONCE = 2**20
"""Waves of an exposure that NumPy computes at a time."""


def exposures_psnr(
    scene: Scene,
    exposures: Frames | Exposures | Instants,
    *,
    lights: Lights | None = None,
    grid: Grid = MEASURED,
    num_panels: int | None = None,
) -> Float[Array, ""]:
    """PSNR of the best linear decoder that registers exposures, in linear light; dB.

    Nothing is compiled for known numbers. The level has derivatives by all numbers of the
    exposures, of the light and of the velocities.

    Args:
        scene: Velocities, light and noise.
        exposures: Exposures of an open shutter: `TimedFrame`s, `PlaneFrames`, or `Exposures`,
            as `best_sequence` finds them. They may move along the axis of the scene, along the
            rows of one in the plane, or in the plane.
        lights: First and last light of each, s, where a gate shortens it.
        grid: Sizes of the fan of directions, for a scene in the plane. Those by default hold a
            level to 0.05 dB, mostly to 0.01 dB; a descent by JAX takes a tenth of the time on
            `mishutter.evaluation.fans.SEARCHED`, as the search does.
        num_panels: Panels of 16 nodes in each exposure, for ways of 7 px each; by default those
            that they need, which are not known inside `jax.jit`.

    Raises:
        ValueError: if there is no exposure or a shaped shutter, they are traced by `jax.jit`
            without `num_panels`, or by JAX for a sensor whose rows are exposed one after another;
            or if something passes more than 10 px of the sensor in a panel, while the program runs
            if numbers are traced.
    """
    require_scene(scene, in_plane=True)
    caller, frames, error = "exposures_psnr", exposures, 0.0
    if not isinstance(exposures, Instants):
        frames = open_frames(f"{caller}(exposures=...)", exposures)
    for share, instants in rows_of(scene, exposures, caller, lights, num_panels):
        fan = fan_of(scene, instants, grid)
        if num_panels is not None:
            speeds = components_on(scene, fan, grid.num_speeds).speeds
            instants = instants.held(speeds, f"{caller}(num_panels=...)", num_panels)
        error += share * left(scene, instants, fan, grid.num_speeds)
    return psnr_of(error, common_dtype(frames))


def rows_of(
    scene: Scene,
    exposures: Frames | Exposures | Instants,
    caller: str,
    lights: Lights | None = None,
    num_panels: int | None = None,
) -> list[tuple[float, Instants]]:
    """Instants of exposures for rows that stand for all, and the share of each.

    They are nodes of the mean over the rows' delays, or one where all rows see the same.
    """
    readout, frames = scene.sensor.readout_time, _alone(exposures)
    if not readout or isinstance(exposures, Instants) or isinstance(frames, Instants):
        return [(1.0, instants_of(scene, frames, caller, lights, num_panels))]
    _require_some(frames, caller)
    path = path_for_rows(scene, exposures)
    way = path.top_speed * float(np.max(np.asarray(path.exposures)))
    rows = ROWS.T if way >= AT_REST else np.array([[0.0, 1.0]])
    return [
        (share, instants_of(scene, path, caller, lights, num_panels, delay=delay * readout))
        for delay, share in rows.tolist()
    ]


def _alone(exposures: Frames | Exposures | Instants) -> Frames | Instants:
    """The frames or instants of exposures."""
    return exposures if isinstance(exposures, Instants) else frames_of(exposures)


def _require_some(frames: Frames, caller: str) -> None:
    count, requirement = frames_in(frames).num_frames, "hold one exposure at least"
    require(count > 0, f"{caller}(exposures=...)", requirement, count)


def instants_of(
    scene: Scene,
    frames: Frames | Instants,
    caller: str,
    lights: Lights | None = None,
    num_panels: int | None = None,
    *,
    delay: float = 0.0,
) -> Instants:
    """Instants of exposures for all velocities of a scene, for a row of some delay."""
    if isinstance(frames, Instants):
        return frames
    _require_some(frames, caller)
    fastest = about = 0.0
    if num_panels is None:
        known = primal_values((frames, scene.speeds, scene.weights, scene.velocities))
        requirement = "be given where JAX traces exposures or velocities"
        require(all_concrete(known), f"{caller}(num_panels=...)", requirement, num_panels)
        primal = primal_values(scene)
        if scene.velocities is not None:
            fastest = float(primal.max_speed)
        else:
            slowest, fastest = (float(each) for each in in_parts(primal).speed_range)
            # Frames that follow things pass few pixels of them, however fast both move.
            about, fastest = (slowest + fastest) / 2, (fastest - slowest) / 2
    options = {"lights": lights, "num_panels": num_panels, "delay": delay}
    return Instants.of(frames, fastest, about=about, **options)


def fan_of(scene: Scene, instants: Instants, grid: Grid) -> Fan:
    """The frequencies that hold the responses of exposures."""
    if scene.velocities is not None:
        return Fan.of(scene, grid)
    way = instants.time.shape[1] / NODES * PX_A_PANEL
    return Fan.of_axis(scene, 32 * math.ceil(max(512, 2 * way) / 32))


def in_parts(scene: Scene) -> Scene:
    """The scene as parts that move on their own, a background among them, without tolerances."""
    require_one_axis(scene)
    layers, scene = scene.occlusion, without_tolerances(scene)
    if layers is None:
        return scene
    is_known = all_concrete((scene.speeds, scene.weights, layers))
    space = np if is_known else jnp
    # A scene may be known inside a function that is traced by others of its numbers.
    with outside_trace() if is_known else nullcontext():
        numbers = scene.speeds, scene.weights, layers.front_share, *Background.of(scene)
        speeds, weights, share, *behind = (space.asarray(x) for x in numbers)
    return scene.with_occlusion(None).without_metadata(
        speeds=space.concatenate([speeds, behind[0]]),
        weights=space.concatenate([share * weights, (1 - share) * behind[1]]),
    )


def velocities_of(scene: Scene) -> tuple[Float[np.ndarray, "v axes"], Float[np.ndarray, "v"]]:
    """Velocities that stand for those of a known scene, and their weights."""
    if scene.velocities is not None:
        velocities, weights = (np.asarray(x, np.float64) for x in scene.velocities.stand_ins())
        parts = _at_rest_too(scene, Components(velocities.T, weights))
        return np.asarray(parts.speeds).T, np.asarray(parts.weights)
    speeds, weights = (x.astype(np.float64) for x in distinct_speeds(in_parts(scene), folds=False))
    return speeds[:, None], weights / weights.sum()


def components_on(scene: Scene, fan: Fan, num_speeds: int) -> Components:
    """Components of the velocities along each line of a fan, `(i, j, l)`; of an axis `(1, 1, l)`.

    Args:
        scene: The scene.
        fan: The fan, which is known.
        num_speeds: Number of those that stand for a law.
    """
    if scene.velocities is None:
        parts = in_parts(scene)
        speeds, weights = parts.speeds, parts.weights
        if parts.speeds_known:
            speeds, weights = distinct_speeds(parts, folds=False)
        return Components(speeds[None, None], (weights / weights.sum())[None, None])
    parts = scene.velocities.components(np.asarray(fan.direction), num_speeds, fan.first)
    return _at_rest_too(scene, parts)


def _at_rest_too(scene: Scene, objects: Components) -> Components:
    """Components of objects, and of the background at rest behind them where there is one."""
    if scene.occlusion is None:
        return objects
    (share,) = as_numpy(scene.occlusion.front_share)
    space = namespace_of(*objects, share)
    rest, never = (space.zeros_like(x[..., :1]) for x in objects)
    return Components(
        space.concatenate([objects.speeds, rest], axis=-1),
        space.concatenate([share * objects.weights, 1 - share + never], axis=-1),
    )


class Light(NamedTuple):
    """Light, noise and picture of a scene; of NumPy where they are known."""

    rate: Numbers  # e-/s
    read: Numbers  # e-
    mean: Numbers  # white = 1
    deviation: Numbers  # white = 1
    blur: Numbers  # px

    @staticmethod
    def of(scene: Scene) -> "Light":
        """That of a scene."""
        picture = scene.picture
        numbers = scene.photon_rate, scene.read_noise, picture.mean_level, picture.deviation
        return Light(*as_numpy(*numbers, scene.optics.lens_blur))

    def signal(self, fan: Fan) -> Float[Array | np.ndarray, "i j"]:
        r"""$SP$ of a picture behind the pixels and the lens."""
        space = namespace_of(fan.radius, fan.direction)
        power = self.deviation**2 * fan.power
        for turn in (space.cos, space.sin):
            response = pixel_response(fan.radius[:, None] * turn(fan.direction), self.blur)
            power = power * response**2
        return power

    def gains(self, exposures: Float[Array | np.ndarray, "n"]) -> Float[Array | np.ndarray, "n"]:
        r"""$e_k^2/N_k$ of exposures."""
        electrons, noise = noise_of_frames(self.rate, exposures, self.mean, self.read)
        return electrons * (electrons / noise)


@alone_in_blas()
def left(scene: Scene, instants: Instants, fan: Fan, num_speeds: int) -> Numbers | np.floating:
    """Squared error that is left, white = 1; by NumPy if all is known."""
    parts = components_on(scene, fan, num_speeds)
    numbers = fan, parts, Light.of(scene), instants, Strips.of(scene)
    if all_concrete(numbers):
        return error_left(*jax.tree.map(np.asarray, numbers))
    return _error_left(*jax.tree.map(lambda x: jnp.asarray(x, instants.time.dtype), numbers))


def error_left(
    fan: Fan, parts: Components, light: Light, instants: Instants, strips: Strips | None
) -> Numbers | np.floating:
    """Squared error that is left, of numbers that are all of NumPy or all of JAX."""
    space, signal = namespace_of(fan.radius), light.signal(fan)
    gains = light.gains(instants.exposure)
    gained = gained_by(fan, parts, instants, gains)
    lost = space.sum(parts.weights / (1 + signal[..., None] * gained), axis=-1)
    total = light.deviation**2 * space.sum(fan.weight * lost)
    if strips is None:
        return total
    middles = space.sum(instants.time * instants.weight, axis=1)
    shares, told = strips.beside(middles, instants.exposure)
    alone = [slice(k, k + 1) for k in range(gains.shape[0])]
    behind = space.stack(
        [gained_by(fan, strips.background, instants.some(k), gains[k])[..., 0] for k in alone]
    )
    # Of each strip, and then of what all frames see.
    seen = space.concatenate([told, space.ones_like(told[:1])])
    known = 1 + signal[None] * space.tensordot(seen, behind, 1)
    errors = light.deviation**2 * space.sum(fan.weight[None] / known, axis=(1, 2))
    outlines = light.deviation**2 * strips.outlines(instants.exposure)
    return total + space.sum(shares * (errors[:-1] - errors[-1])) + outlines


_error_left = compiled(error_left)


def gained_by(
    fan: Fan, parts: Components, instants: Instants, gains: Float[Array | np.ndarray, "n"]
) -> Float[Array | np.ndarray, "i j l"]:
    r"""$\sum_k g_k|H_k|^2$ at each frequency and component of the velocities."""
    time, place, weight, _ = instants
    # Only |H| counts: places and times near 0 have small phases.
    time, place = time - (time[:, :1] + time[:, -1:]) / 2, place - place[..., :1]
    shape = (*fan.direction.shape, parts.speeds.shape[-1])
    if namespace_of(time, fan.radius) is np:
        total = np.zeros(shape)
        # Exposures of one length share the waves of things.
        same = np.round(time / max(np.max(np.abs(time)), np.finfo(float).tiny), 9)
        _, group = np.unique(same, axis=0, return_inverse=True)
        groups = [np.flatnonzero((group == k) & (gains > 0)) for k in range(np.max(group) + 1)]
        each = shape[1] * (shape[2] + time.shape[0]) * time.shape[1]
        num_parts = min(shape[0], math.ceil(shape[0] * each / _AT_ONCE))
        for rows in np.array_split(np.arange(shape[0]), num_parts):
            own = Fan(fan.radius[rows], *(x[rows] for x in fan[1:]))
            along = jax.tree.map(lambda x, rows=rows: x[rows] if len(x) > 1 else x, parts)
            for some in filter(len, groups):
                power = passed(own, along, time[some[0]], place[:, some], weight[some])
                total[rows] += np.einsum("k,ijkl->ijl", gains[some], power)
        return total

    # A descent holds the waves of one exposure at a time.
    @jax.checkpoint
    def add(total: Array, exposure: tuple[Array, ...]) -> tuple[Array, None]:
        gain, *nodes = exposure
        return total + gain * passed(fan, parts, *nodes)[:, :, 0], None

    each = gains, time, jnp.moveaxis(place, 1, 0)[:, :, None], weight[:, None]
    return jax.lax.scan(add, jnp.zeros(shape, time.dtype), each)[0]


def passed(
    fan: Fan,
    parts: Components,
    time: Float[Array | np.ndarray, "q"],
    place: Float[Array | np.ndarray, "axes k q"],
    weight: Float[Array | np.ndarray, "k q"],
) -> Float[Array | np.ndarray, "i j k l"]:
    r"""$|H|^2$ of exposures at the same times, by frequency and component of the velocities."""
    space = namespace_of(fan.radius, time)
    turns = 2 * np.pi * fan.radius[:, None, None]
    along = sum(
        turn(fan.direction)[..., None, None] * way[None, None]
        for turn, way in zip((space.cos, space.sin), place, strict=False)
    )
    ways = space.broadcast_to(turns * parts.speeds, (*fan.direction.shape, parts.speeds.shape[-1]))
    phases = [turns[..., None] * along, ways[..., None] * time[None, None, None]]
    if space is np and fan.direction.shape[1] > 1:
        # Sines of single precision, in a tenth of the time, err far less than a mean over a plane.
        phases = [x - 2 * np.pi * np.rint(x / (2 * np.pi)) for x in phases]
        phases = [x.astype(np.float32) for x in phases]
    return power_of_waves(*phases, weight[None, None])


def power_of_waves(
    on_sensor: Float[Array | np.ndarray, "*f k q"],  # Phases of the places of a sensor; rad
    passing: Float[Array | np.ndarray, "*f n q"],  # Phases of the ways of things; rad
    weight: Float[Array | np.ndarray, "#*f #k q"],
) -> Float[Array | np.ndarray, "*f k n"]:
    r"""$|\sum_q w_q e^{i(\beta_q - \alpha_q)}|^2$ for each sensor and thing.

    A wave of a difference is a product of waves, so that the sums are products of matrices, in real
    numbers.
    """
    space = namespace_of(on_sensor, passing, weight)
    cosine, sine = space.cos(passing), space.sin(passing)
    weight = weight.astype(cosine.dtype)
    sensor = space.concatenate(
        [weight * space.cos(on_sensor), weight * space.sin(on_sensor)], axis=-1
    )
    real, imaginary = (
        sensor @ space.swapaxes(space.concatenate(pair, axis=-1), -1, -2)
        for pair in ((cosine, sine), (sine, -cosine))
    )
    return real**2 + imaginary**2


def psnr_of(error: Numbers | np.floating | float, dtype: np.dtype) -> Float[Array, ""]:
    """The level of a squared error; dB."""
    if not all_concrete(error):
        return -10 * jnp.log10(error)
    with np.errstate(divide="ignore"):
        return as_float(np.asarray(-10 * np.log10(np.asarray(error)), dtype))


def psnr_of_error(error: float) -> float:
    """The level of a squared error; dB. Without any error it is infinite."""
    return -10 * math.log10(error) if error > 0 else math.inf
