"""Pictures as rows of a continuous, band-limited scene, and their continuation beyond the ends.

Arrays hold rows on their last axis. A row of `W` pixels becomes one period of a periodic row, of
which the discrete Fourier transform is the spectrum of the band-limited scene through its pixels.
"""

import itertools
import math
from collections.abc import Callable
from types import ModuleType
from typing import Literal, NamedTuple, get_args

import jax.numpy as jnp
import numpy as np
import scipy.fft
from jaxtyping import Array, ArrayLike, Complex, Float

from mishutter._core.checks import (
    Alike,
    Numbers,
    is_concrete,
    namespace_of,
    require,
    require_positive_int,
)
from mishutter.evaluation.instants import Instants
from mishutter.model.frame_path import Frames, frames_in
from mishutter.model.motion import AbstractMotion
from mishutter.model.sensor import Sensor

rfftn: Callable[..., np.ndarray] = scipy.fft.rfftn  # type: ignore[assignment]
irfftn: Callable[..., np.ndarray] = scipy.fft.irfftn  # type: ignore[assignment]
"""In the precision of what is transformed, and typed, which SciPy's own are not."""
Planes = Array | np.ndarray
"""Rows of light: of NumPy where they are concrete, so that moving them compiles no program."""
Border = Literal["scene", "reflect", "edge", "wrap", "zero"]
PAD_MODES = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}
MARGIN = 64
"""Pixels beyond the reach of the blur, in which the waves of an end of the picture die away."""
ONE_BAND = 0.05
"""Way of anything over the time in which the rows of a band are exposed one after another; px."""
PX_A_NODE = 0.4
"""Way of anything between neighbouring delays of rows, where those between are interpolated; px."""
_LEAST_SHARE = 1e-6
"""Share of a picture in a row below which it is none."""
MAX_REACH = 1 << 13
"""Furthest that light of a capture may be displaced; px."""


def blur_length(motion: AbstractMotion, *speeds: float, subject: str) -> float:
    """Length over which light falls at the fastest of some speeds, a pixel included; px."""
    half, still = float(motion.half_exposure), motion.without_velocity()
    fastest = max(abs(float(s) - float(motion.velocity)) for s in speeds)
    reach = float(still.kernel_length(np.asarray(fastest, still.half_exposure.dtype)))
    longest = max(reach, 2 * fastest * half) + 1
    alone = 2 * max(abs(float(s)) for s in speeds) * half + 1
    subject = subject if alone > MAX_REACH else "motion"
    is_short = math.isfinite(longest) and longest <= MAX_REACH
    require(is_short, subject, f"blur over at most {MAX_REACH} px", longest)
    return longest


class Band(NamedTuple):
    """Rows of a picture that are exposed at once, as far as anything moves meanwhile."""

    delay: float  # Time by which they are exposed later than the middle of all rows; s
    rows: slice


def bands_of(sensor: Sensor, num_rows: int, fastest: float) -> list[Band]:
    """Rows of a sensor in bands over which nothing moves by more than `ONE_BAND`.

    Args:
        sensor: The sensor.
        num_rows: Rows of the picture.
        fastest: Greatest speed of anything on the sensor; px/s.
    """
    delays = sensor.row_delays(num_rows)
    way = fastest * abs(float(delays[-1] - delays[0]))
    count = min(num_rows, max(1, math.ceil(way / ONE_BAND)))
    edges = np.round(np.linspace(0, num_rows, count + 1)).astype(int).tolist()
    rows = [slice(*pair) for pair in itertools.pairwise(edges)]
    return [Band(float(np.mean(delays[each])), each) for each in rows]


def nodes_of(
    sensor: Sensor, num_rows: int, fastest: float
) -> tuple[Float[np.ndarray, "d"], Float[np.ndarray, "d rows"]]:
    """Delays of a few rows, and the share that a picture at each has in each row, by a spline.

    Rows are taken by themselves where these are not fewer.

    Args:
        sensor: The sensor.
        num_rows: Rows of the picture.
        fastest: Greatest speed of anything on the sensor; px/s.
    """
    from scipy.interpolate import CubicSpline

    delays = sensor.row_delays(num_rows)
    low, high = float(np.min(delays)), float(np.max(delays))
    way = fastest * (high - low)
    if way <= ONE_BAND:
        return np.array([(low + high) / 2]), np.ones((1, num_rows))
    if 3 + way / PX_A_NODE >= num_rows:
        return delays, np.eye(num_rows)
    nodes = np.linspace(low, high, 4 + int(way / PX_A_NODE))
    shares = CubicSpline(nodes, np.eye(nodes.size))(delays).T
    return nodes, np.where(np.abs(shares) < _LEAST_SHARE, 0.0, shares)


def seen_in_turn(
    spectrum: Complex[np.ndarray, "... rows k"],
    response: Complex[np.ndarray, "d k"],  # Of each row, or of each pixel of the window
    window: slice,
    period: int,
    *,
    is_along: bool,
) -> Float[np.ndarray, "... rows pixels"]:
    """A window of periodic rows, of which rows, or pixels along them, are exposed in turn."""
    if is_along:
        waves = waves_at(window.start, response.shape[0], period)
        return pixels_through(response * waves, spectrum, period)
    return np.fft.irfft(spectrum * response, period)[..., window]


def pixels_through(
    matrix: Complex[np.ndarray, "*s pixels k"], spectrum: Complex[np.ndarray, "... k"], period: int
) -> Float[np.ndarray, "... pixels"]:
    """Pixels of periodic rows, each through its response times the waves of a DFT there."""
    return np.real((spectrum * (counted_in(period) / period)) @ np.swapaxes(matrix, -1, -2))


def waves_at(first: int, count: int, period: int) -> Complex[np.ndarray, "{count} k"]:
    """Waves of half of a DFT at pixels from one on."""
    places = first + np.arange(count)
    turns = np.multiply.outer(places, np.arange(period // 2 + 1)) % period
    return np.exp(2j * np.pi / period * turns)


def counted_in(period: int) -> Float[np.ndarray, "k"]:
    """How often the whole of a DFT has each frequency of its half."""
    counted = np.full(period // 2 + 1, 2.0)
    counted[0] = 1.0
    if period % 2 == 0:
        counted[-1] = 1.0
    return counted


def instants_within_reach(
    subject: str, frames: Frames, velocity: Float[np.ndarray, "axes"], delay: float = 0.0
) -> Instants:
    """Instants of frames at a velocity that displaces light by no more than `MAX_REACH`."""
    speed = float(np.hypot(*velocity) if velocity.size > 1 else abs(velocity[0]))
    longest = speed * float(np.max(np.asarray(frames_in(frames).exposures)))
    requirement = f"displace light by at most {MAX_REACH} px"
    # Before there are as many nodes as such a displacement would need.
    require(longest <= 2 * MAX_REACH, subject, requirement, longest)
    instants = Instants.of(frames, speed, delay=delay)
    reach = max(instants.reach(velocity[None]))
    require(reach <= MAX_REACH, subject, requirement, reach)
    return instants


def window_of(count: int, size: int | None, argument: str, word: str) -> slice:
    """The middle pixels of a picture along an axis, over which a sensor of a size lies."""
    size = count if size is None else size
    subject = f"simulate_frames({argument}=...)"
    require_positive_int(subject, size)
    require(size <= count, subject, f"be at most the picture's {count} {word}", size)
    start = (count - size) // 2
    return slice(start, start + size)


def require_border(subject: str, border: object) -> None:
    """Refuse an unknown border rule."""
    names = get_args(Border)
    require(border in names, subject, f"be one of {', '.join(names)}", border)


def period_of(columns: int, reach: int, border: str) -> int:
    """Pixels of one period of rows that a border rule continues; at least `columns`."""
    if border == "wrap":
        return columns
    if border in ("reflect", "scene"):
        return 2 * columns
    return fast_length(columns + 2 * (reach + MARGIN))


def continued(rows: Alike, period: int, border: str) -> Alike:
    """Rows continued by a border rule to one period of `period_of`, their own pixels first.

    Mirrored rows repeat themselves after twice their length. Rows that go on as their last pixel
    come back to their first one by a slope, beyond the reach of the blur.
    """
    space = namespace_of(rows)
    columns = rows.shape[-1]
    if border in ("reflect", "scene"):
        return space.concatenate([rows, rows[..., ::-1]], axis=-1)
    if border == "edge":
        share = edge_shares(columns, period)
        share = share.reshape((1,) * (rows.ndim - 1) + (-1,)).astype(rows.dtype)
        gap = rows[..., -1:] * (1 - share) + rows[..., :1] * share
        return space.concatenate([rows, gap], axis=-1)
    return space.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, period - columns)])


def edge_shares(columns: int, period: int) -> Float[np.ndarray, "gap"]:
    """Shares of the first pixel in the slope that leads back to it from the last one."""
    third = (period - columns) // 3
    return np.clip((np.arange(period - columns) + 0.5 - third) / third, 0, 1)


def blurred(
    rows: Float[Array, "*planes columns"], response: ArrayLike
) -> Float[Array, "*planes columns"]:
    """Periodic rows through a response on the grid of their DFT."""
    spectrum = jnp.fft.rfft(rows)
    return jnp.fft.irfft(spectrum * along_rows(response, spectrum), rows.shape[-1])


def along_rows(vector: ArrayLike, like: Array) -> Array:
    """A vector with as many axes, and the precision, of the rows that it is to meet."""
    return jnp.asarray(vector, like.dtype).reshape((1,) * (like.ndim - 1) + (-1,))


def fast_length(least: int) -> int:
    """Smallest length of at least `least` whose only factors are 2, 3 and 5, and even."""
    return 2 * int(scipy.fft.next_fast_len(-(-least // 2), real=True))  # type: ignore[arg-type]


def rows_last(image: ArrayLike) -> Planes:
    """A picture `(..., rows, columns, channels)` or `(rows, columns)`, columns last.

    The result has the shape `(..., channels, rows, columns)`; NumPy's of a concrete picture.
    """
    space, picture = _in_its_space(image)
    picture = picture[..., None] if picture.ndim == 2 else picture
    return space.moveaxis(picture, -1, -3)


def channels_last(planes: Planes, like: ArrayLike) -> Planes:
    """Undo `rows_last`, for a picture that had as many axes as `like`."""
    space, planes = _in_its_space(planes)
    picture = space.moveaxis(planes, -3, -1)
    return picture[..., 0] if np.ndim(like) == 2 else picture


def _in_its_space(values: ArrayLike) -> tuple[ModuleType, Numbers]:
    """NumPy and its array of concrete rows; JAX's NumPy and the rows where they are traced."""
    return (np, np.asarray(values)) if is_concrete(values) else (jnp, jnp.asarray(values))
