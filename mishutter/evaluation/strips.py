r"""Edges of objects before a background at rest cost frames strips beside them, and outlines.

The picture is that of the middle of the frames. A point of the background that an object uncovers a
time $\tau$ before it, or covers as long after it, is in frame $k$ for the share $u_k(\tau)$ of its
exposure, and the frame tells $u_k^2$ as much of it as of others: what it shows besides is the
object, which all frames see. On either side such points are the share
$p(1 - p)\,r e^{-r\tau}\,d\tau$ of the picture, $r = |\mathbf v|/\ell$, $\ell = W(1 - p)$, where
objects are the share $p$ of it and of exponential widths, of mean $W$, along their way. Where they
move in any direction, their strips lie along each of their velocities, of which the mean is taken.

Outlines are found in the frames. The decoder of this package puts an edge, of which there are
$2p/W$ to a pixel, in its place to $\delta^2 = \kappa/\sum_k(1 + b_k^2)^{-1/2}$ px², where
$b_k = |\mathbf v|T_k$ is the blur of frame $k$: the longer a ramp is, the less it tells of its
place. That leaves $2\sigma^2\delta^2$ there, of pictures of the variance $\sigma^2$: measured
(`benchmarks/strips.py`), from 3 to 20 ms at 315 to 855 px/s.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import Numbers, as_numpy, namespace_of
from mishutter.model.scene import Scene
from mishutter.model.velocities import Components

_PARTS = 32
"""Parts of the time on either side of the middle, which hold levels to 0.001 dB."""
_OUTLINES = 0.17
"""Square of the error of an edge in one frame without blur, $\\kappa$; px^2."""


class Strips(NamedTuple):
    """Objects before a background at rest; of NumPy where they are known."""

    share: (
        Numbers | np.floating
    )  # Share of the picture that is not hidden now and is at a time far away
    edges: Numbers | np.floating  # Edges to a pixel, along the way of the objects
    speeds: Float[Array | np.ndarray, "v"]  # Of objects before the background; px/s
    rates: Float[Array | np.ndarray, "v"]  # Rates at which edges pass, 1/s
    weights: Float[Array | np.ndarray, "v"]  # How often each occurs
    background: Components  # The speed of the background

    @staticmethod
    def of(scene: Scene) -> "Strips | None":
        """Those of a scene; None of one without edges, or whose background moves."""
        layers = scene.occlusion
        if layers is None or layers.object_width is None or layers.background != "still":
            return None
        numbers = scene.speeds, scene.weights, layers.front_share, layers.object_width
        speeds, weights, front, width, behind = as_numpy(*numbers, layers.background_speed)
        space = namespace_of(speeds, front, width)
        speeds = space.abs(speeds - behind)
        if scene.velocities is not None:
            velocities, weights = scene.velocities.stand_ins()
            speeds = namespace_of(velocities).hypot(velocities[:, 0], velocities[:, 1])
        # Without any gap between objects nothing is behind them.
        length = width * space.where(front < 1, 1 - front, 1.0)
        rest = space.reshape(behind, (1, 1, 1))
        background = Components(rest, space.ones_like(rest))
        weights = weights / namespace_of(weights).sum(weights)
        numbers = front * (1 - front), 2 * front / width, speeds, speeds / length
        return Strips(*numbers, weights, background)

    def beside(
        self, time: Float[Array | np.ndarray, "n"], exposure: Float[Array | np.ndarray, "n"]
    ) -> tuple[Float[Array | np.ndarray, "s"], Float[Array | np.ndarray, "s n"]]:
        """Shares of the picture that the strips have, and what each frame tells of them.

        Args:
            time: Mid-exposures, from the middle of all; s.
            exposure: Times for which each is lit; s.
        """
        space = namespace_of(time, exposure, self.rates, self.weights)
        ends = space.max(space.abs(time) + exposure / 2) * (np.arange(_PARTS + 1) / _PARTS)
        kept = space.exp(-ends[:, None] * self.rates[None]) @ self.weights
        middles = ((ends[1:] + ends[:-1]) / 2)[:, None]
        lasting = space.where(exposure > 0, exposure, 1.0)
        seen = [
            space.clip((middles + side * time[None]) / lasting[None] + 0.5, 0.0, 1.0)
            for side in (1.0, -1.0)
        ]
        shares = self.share * (kept[:-1] - kept[1:])
        return space.concatenate([shares, shares]), space.concatenate(seen) ** 2

    def outlines(self, exposure: Float[Array | np.ndarray, "n"]) -> Numbers | np.floating | float:
        """Squared error that outlines leave, over the variance of pictures.

        One exposure, of which no outline is found, loses nothing.
        """
        if exposure.shape[0] == 1:
            return 0.0
        sharp = 1 / (1 + (self.speeds[:, None] * exposure[None]) ** 2) ** 0.5
        return self.edges * 2 * _OUTLINES * (self.weights @ (1 / sharp.sum(axis=1)))
