r"""Instants of exposures: when light counts, and where the sensor is then.

Levels, losses, captures and restorations take nothing else of exposures: the response of one to a
thing of the velocity $\mathbf v$ is
$H = \sum_q w_q\,e^{-2\pi i\,\mathbf f\cdot(\mathbf x_q - \mathbf v\,t_q)}$, where the places
$\mathbf x_q$ have one component or two. Times are Gauss-Legendre nodes of panels of the exposure.
"""

import math
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import (
    all_concrete,
    common_dtype,
    namespace_of,
    primal_values,
    require,
)
from mishutter._core.compiling import outside_trace
from mishutter.model.frame_path import Frames, Lights, frames_in

NODES = 16
"""Nodes of a panel."""
PX_A_PANEL = 7.0
"""Way over a panel that its nodes hold to 1e-11 at the highest frequency of an axis; px."""
_MOST_PX_A_PANEL = 10.0
"""Way over a panel beyond which its nodes are refused: they hold it to 1e-7; px."""


Index = slice | int | Sequence[int] | np.ndarray
"""Some of the exposures."""


class Instants(NamedTuple):
    """Instants of exposures, and where the sensor is then; arrays of JAX where these are traced."""

    time: Float[np.ndarray, "n q"]  # Times from the middle of all; s
    # Places of the sensor along each axis, from that in the middle of all; px
    place: Float[np.ndarray, "axes n q"]
    # Share of its exposure that each stands for, times the transmittance then
    weight: Float[np.ndarray, "n q"]
    exposure: Float[np.ndarray, "n"]  # Time for which each exposure is lit; s

    @staticmethod
    def of(
        frames: Frames,
        fastest: ArrayLike,
        *,
        lights: Lights | None = None,
        num_panels: int | None = None,
        size: int = 1,
        delay: float = 0.0,
        about: ArrayLike = 0.0,
    ) -> "Instants":
        """Instants of exposures for all things up to a speed; by NumPy where they are concrete.

        Args:
            frames: The exposures.
            fastest: That speed, beside `about`; px/s.
            lights: First and last light of each, s, where these are not the exposure's own, but
                those of a shorter shutter.
            num_panels: Panels of 16 nodes in each; by default those that known exposures need.
            size: Side of the pixels that places are counted in; px.
            delay: Time by which a row is exposed later than the middle of all, and sees the later
                part of the path, which is known; s.
            about: Velocity that all things move about, along each axis; px/s.
        """
        if num_panels is None:
            known, fastest, about = primal_values((frames, fastest, about))
            is_known, requirement = all_concrete((known, fastest)), "be given where JAX traces them"
            require(is_known, "exposures_psnr(num_panels=...)", requirement, num_panels)
            few = Instants.of(known, 0.0, lights=lights, num_panels=2, delay=delay)
            velocity = np.broadcast_to(np.asarray(about, np.float64), few.place.shape[:1])
            ways = few.ways(velocity) + float(np.asarray(fastest)) * few.exposure
            way = float(np.max(ways)) / size
            require(math.isfinite(way), "exposures_psnr(exposures=...)", "be finite numbers", way)
            num_panels = panels_for(way)
        with outside_trace() if all_concrete(frames) else nullcontext():
            space, dtype = np, np.dtype(np.float64)
            if not all_concrete(frames):  # some numbers may be known
                space, dtype = jnp, common_dtype(frames)
            taken = jax.tree.map(lambda x: space.asarray(x, dtype), frames_in(frames))
            begin, end = _lights(taken.times, taken.exposures, lights)
            begin, end = begin + delay, end + delay
            time, weight = _nodes(begin, end, taken.cuts(begin, end, delay), num_panels)
            middle, at = taken.middle
            place = taken.place(time) - at[:, None, None]
            since = time - middle
            instants = Instants(since, place, weight, end - begin)  # type: ignore[arg-type]
        return instants if size == 1 else instants._replace(place=instants.place / size)

    def held(self, speeds: ArrayLike, subject: str, num_panels: int) -> "Instants":
        """These instants, which are an error where a thing passes more in a panel than it holds.

        The error is raised while the program runs where numbers are traced.
        """
        known = primal_values((self.time, self.place, speeds))
        space = np if all_concrete(known) else jnp
        time, place, speeds = (space.asarray(x) for x in known)
        steps = space.linalg.norm(space.diff(place), axis=0)
        steps = steps + space.max(space.abs(speeds)) * space.diff(time)
        # Steps between nodes, the last of which leads into the next panel.
        steps = space.concatenate([steps, 0 * steps[:, :1]], axis=1)
        ways = steps.reshape(*steps.shape[:1], -1, NODES)[..., :-1].sum(axis=-1)
        requirement = f"be so many that nothing passes more than {_MOST_PX_A_PANEL:g} px in a panel"
        exceeds = ways.max() > _MOST_PX_A_PANEL
        if all_concrete(exceeds):
            require(not exceeds, subject, requirement, num_panels)
            return self
        message = f"`{subject}` must {requirement}; got {num_panels}."
        return self._replace(weight=eqx.error_if(jnp.asarray(self.weight), exceeds, message))

    def displacement(self, velocity: Float[np.ndarray, "axes"]) -> Float[np.ndarray, "axes n q"]:
        """Way of a thing on the sensor since the middle of all; px."""
        return self.place - velocity[:, None, None] * self.time

    def ways(self, velocity: Float[np.ndarray, "axes"]) -> Float[np.ndarray, "n"]:
        """Length of the way of a thing in each exposure; px."""
        steps = np.diff(self.displacement(velocity))
        return np.sum(np.linalg.norm(steps, axis=0), axis=-1)

    def middles(self, velocity: Float[np.ndarray, "axes"]) -> Float[np.ndarray, "axes n"]:
        """The mean way of a thing in each exposure; px."""
        return np.sum(self.displacement(velocity) * self.weight, axis=-1)

    def reach(self, velocities: Float[np.ndarray, "s axes"]) -> list[float]:
        """Furthest displacement along each axis at some velocities; px."""
        each = [np.max(np.abs(self.displacement(v)), axis=(1, 2)) for v in velocities]
        return np.max(each, axis=0).tolist()

    def some(self, index: Index) -> "Instants":
        """Those of some of the exposures."""
        time, place, weight, exposure = self
        return Instants(time[index], place[:, index], weight[index], exposure[index])

    def part(self, index: Index) -> "Instants":
        """Those of some exposures, from the mean of their own times and places on."""
        some = self.some(index)
        middle = np.mean(some.place, axis=(1, 2), keepdims=True)
        return some._replace(time=some.time - np.mean(some.time), place=some.place - middle)


def panels_for(way: float) -> int:
    """Panels of each exposure that hold a way; px. They are of few sizes, as programs are."""
    panels = 1 + way / PX_A_PANEL
    step = 2 ** max(0, math.ceil(math.log2(panels)) - 2)
    return step * math.ceil(panels / step)


def _nodes(begin: Any, end: Any, cuts: Any, num_panels: int) -> tuple[Any, Any]:
    """Times of nodes and their weights, between two times and at cuts between them; `(n, q)`."""
    space, dtype = namespace_of(begin, end, cuts), begin.dtype
    shares = (np.arange(num_panels + 1) / num_panels).astype(dtype)
    edges = begin[:, None] + (end - begin)[:, None] * shares[None]
    if cuts.shape[1]:
        cuts = space.clip(cuts, begin[:, None], end[:, None])
        edges = space.sort(space.concatenate([edges, cuts], axis=1), axis=1)
    x, weight = (part.astype(dtype) for part in np.polynomial.legendre.leggauss(NODES))
    middle, half = (edges[:, 1:] + edges[:, :-1]) / 2, (edges[:, 1:] - edges[:, :-1]) / 2
    time = (middle[..., None] + half[..., None] * x[None, None]).reshape(begin.size, -1)
    # An exposure of no length is no frame, and its nodes have the weights of any other.
    length = space.where(end > begin, end - begin, 1.0)
    share = space.where((end > begin)[:, None], half / length[:, None], 0.5 / half.shape[1])
    return time, (share[..., None] * weight[None, None]).reshape(begin.size, -1)


def _lights(times: Any, exposures: Any, lights: Lights | None) -> tuple[Any, Any]:
    """First and last light of exposures."""
    if lights is None:
        return times - exposures / 2, times + exposures / 2
    begin, end = np.transpose(np.asarray(lights)).astype(times.dtype)
    return begin, end
