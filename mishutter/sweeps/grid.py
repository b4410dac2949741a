"""The definition of a sweep: its grid, its scenes and shutters, its limits, its blocks."""

import hashlib
import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt

from mishutter._core.checks import RowLike, common_dtype, describe, require, shape_of
from mishutter.design.design import package_version, scene_to_dict
from mishutter.evaluation.losses import AbstractLoss
from mishutter.evaluation.metrics import METRICS
from mishutter.evaluation.speed_knowledge import SpeedKnowledge, knowledge_of
from mishutter.model.limits import LIMITS
from mishutter.model.motion import LinearMotion
from mishutter.model.scene import Scene, in_sensor_frame
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import shutter_to_dict
from mishutter.model.shutters.spline import SplineShutter

_BITS = {limit.name: limit.bit for limit in LIMITS} | {"full_well": 4, "blur_too_long": 8}
REASONS = tuple(sorted(_BITS, key=_BITS.__getitem__))
"""Reasons to leave a point out, in the order of the bits of `outside`."""
MARKS = np.dtype(np.uint16)
"""Precision of `outside`: it has as many bits as there are reasons, at least."""

OPTIMISED = "optimised"
FORMAT = 4
_SEARCH_BLOCK = 16


class Search(NamedTuple):
    """Settings of the search for the best profile at each point."""

    loss: AbstractLoss  # The loss to minimise
    # A profile of the kind that is searched in each frame, to start from
    profiles: tuple[SplineShutter, ...]
    max_steps: int  # Most steps of each search
    seed: int  # Seed of the random starts

    @property
    def num_coefficients(self) -> int:
        """Coefficients of each profile."""
        return self.profiles[0].num_coefficients

    def describe(self) -> dict[str, object]:
        """Everything that decides the profiles beside the scenes, as plain numbers and text."""
        return {
            "loss": repr(self.loss),
            "num_coefficients": self.num_coefficients,
            "max_steps": self.max_steps,
            "seed": self.seed,
        }


class Frame(NamedTuple):
    """A scene and the velocity of a sensor that pans."""

    scene: Scene  # The scene at rest
    velocity: float  # Velocity of the sensor at mid-exposure; px/s

    @property
    def sensor_scene(self) -> Scene:
        """The scene in the frame of the sensor, which may pan no further."""
        velocity = np.asarray(self.velocity, self.scene.speeds.dtype)
        motion = LinearMotion(half_exposure=1.0, velocity=velocity)
        return in_sensor_frame(self.scene, motion)[0].without_pan()


def frames_of(scenes: Iterable[Scene], velocities: np.ndarray | None) -> list[Frame]:
    """Frames of scenes at some velocities; by default each at the middle of its speeds.

    That is as far as the scene's limits let its sensor pan.
    """
    if velocities is None:
        return [Frame(scene, float(scene.fullest_motion.velocity)) for scene in scenes]
    return [Frame(scene, velocity) for scene in scenes for velocity in velocities.tolist()]


def decoders_of(scenes: Iterable[Scene], loss: AbstractLoss | None) -> tuple[SpeedKnowledge, ...]:
    """The decoders that a loss or else scenes name, each once."""
    return tuple({k.name: k for k in (knowledge_of(scene, loss) for scene in scenes)}.values())


class Block(NamedTuple):
    """A rectangle of the grid of one frame, which is computed and written at once."""

    frame: int
    acceleration: int
    half_exposure: int


@dataclass(frozen=True)
class Grid:
    """A sweep as it was asked for; see `sweep`."""

    accelerations: Float[np.ndarray, "a"]  # $a$, ascending; px/s^2
    half_exposures: Float[np.ndarray, "t"]  # $T$, ascending; s
    # $v$, ascending, px/s; None for the middle of each scene's speeds
    velocities: Float[np.ndarray, "v"] | None
    scenes: dict[str, Scene]  # Scenes by name
    shutters: dict[str, AbstractShutter]  # Fixed shutters by name
    metrics: tuple[str, ...]  # Names of the metrics to compute
    photon_rates: Float[np.ndarray, "p"] | None  # Photon rates, e-/s; None for each scene's own
    read_noises: Float[np.ndarray, "r"] | None  # Read noises, e-; None for each scene's own
    full_well: float | None  # Most electrons of a pixel, e-; None for no limit
    # Settings of the search for the best profile; None for fixed shutters alone
    search: Search | None
    named_scenes: bool  # Whether scenes are a dimension

    @property
    def dtype(self) -> np.dtype:
        """Precision of the results: that of the scenes and shutters."""
        speeds = [scene.speeds for scene in self.scenes.values()]
        return common_dtype(speeds, self.shutters)

    @property
    def decoders(self) -> tuple[SpeedKnowledge, ...]:
        """The decoders that the loss of a search or else the scenes name, each once."""
        loss = None if self.search is None else self.search.loss
        return decoders_of(self.scenes.values(), loss)

    @property
    def level(self) -> str:
        """Name of the metric that judges designs; that of one filter for all speeds if others do.

        Others are scenes of several decoders, or metrics that are named without that of the
        decoder.
        """
        judges = {each.judge(scene) for scene in self.scenes.values() for each in self.decoders}
        (first, *others) = judges
        return "expected_psnr" if others or first not in self.metrics else first

    @property
    def shutter_names(self) -> tuple[str, ...]:
        """The fixed shutters, then the optimised one."""
        return (*self.shutters, *([OPTIMISED] if self.search else []))

    @cached_property
    def frames(self) -> list[Frame]:
        """Every frame, in order: those of a scene one after the other."""
        return frames_of(self.scenes.values(), self.velocities)

    @property
    def frame_sizes(self) -> dict[str, int]:
        """Dimensions that frames are along, and their lengths."""
        sizes = {"scene": len(self.scenes)} if self.named_scenes else {}
        return sizes if self.velocities is None else sizes | {"velocity": self.velocities.size}

    @property
    def sizes(self) -> dict[str, int]:
        """Every dimension and its length, in order."""
        sizes = self.frame_sizes | {
            "acceleration": self.accelerations.size,
            "half_exposure": self.half_exposures.size,
            "shutter": len(self.shutter_names),
        }
        if self.photon_rates is not None:
            sizes["photon_rate"] = self.photon_rates.size
        if self.read_noises is not None:
            sizes["read_noise"] = self.read_noises.size
        if self.search is not None:
            sizes["coefficient"] = self.search.num_coefficients
        return sizes

    def dimensions(self, name: str) -> tuple[str, ...]:
        """Names of the dimensions of a variable, in the order of its axes."""
        place = (*self.frame_sizes, "acceleration", "half_exposure")
        dimensions_of_light = tuple(d for d in ("photon_rate", "read_noise") if d in self.sizes)
        if name in ("num_taps", "dft_length", "loss", "converged"):
            return place
        if name == "coefficients":
            return (*place, "coefficient")
        if name == "outside":
            by_light = tuple(d for d in dimensions_of_light if d == "photon_rate")
            return (*place, "shutter", *by_light) if self.full_well is not None else place
        return (*place, "shutter", *(dimensions_of_light if METRICS[name].sees_light else ()))

    @property
    def variables(self) -> dict[str, np.dtype]:
        """Every variable and its precision."""
        dtypes: dict[str, np.dtype] = dict.fromkeys(self.metrics, self.dtype)
        if "condition_number" in self.metrics:
            dtypes |= dict.fromkeys(("num_taps", "dft_length"), np.dtype(np.int32))
        if self.search is not None:
            dtypes |= {"loss": self.dtype, "coefficients": self.dtype, "converged": np.dtype(bool)}
        return dtypes | {"outside": MARKS}

    @cached_property
    def block_shape(self) -> tuple[int, int]:
        """Numbers of accelerations and half exposures of a block, by the size of its results."""
        rows, columns = self.accelerations.size, self.half_exposures.size
        if self.search is not None:
            return min(rows, _SEARCH_BLOCK), min(columns, _SEARCH_BLOCK)
        counts = [x.size for x in (self.photon_rates, self.read_noises) if x is not None]
        point = 8 * len(self.metrics) * len(self.shutters) * int(np.prod([1, *counts]))
        rows = min(rows, 128)
        # A block has 16 MiB or 4,096 points at most.
        return rows, int(np.clip(min((1 << 24) // point, 4096) // rows, 1, columns))

    def blocks(self) -> list[Block]:
        """Every block, frame by frame, and in each along the half exposures first."""
        rows, columns = self.block_shape
        frames = range(len(self.frames))
        accelerations = range(-(-self.accelerations.size // rows))
        half_exposures = range(-(-self.half_exposures.size // columns))
        indices = itertools.product(frames, accelerations, half_exposures)
        return [Block(*index) for index in indices]

    def place(self, block: Block) -> tuple[slice, slice]:
        """Slices of the grid's accelerations and half exposures that a block holds."""
        rows, columns = self.block_shape
        a, t = block.acceleration * rows, block.half_exposure * columns
        return slice(a, min(a + rows, self.accelerations.size)), slice(
            t, min(t + columns, self.half_exposures.size)
        )

    def region(self, block: Block, name: str) -> tuple[int | slice, ...]:
        """Index of a block's values in the whole array of a variable."""
        dimensions = self.dimensions(name)
        of_frame = np.unravel_index(block.frame, tuple(self.frame_sizes.values()))
        place = (*map(int, of_frame), *self.place(block))
        return place + (slice(None),) * (len(dimensions) - len(place))

    def num_points(self, blocks: Iterable[Block]) -> int:
        """Number of points that some blocks hold, those outside the limits included."""
        places = map(self.place, blocks)
        return sum((a.stop - a.start) * (t.stop - t.start) for a, t in places)

    def describe(self) -> dict[str, object]:
        """Everything that decides the results, as plain numbers and text."""
        search = None if self.search is None else self.search.describe()
        return {
            "format": FORMAT,
            "mishutter": package_version(),
            "precision": str(self.dtype),
            "accelerations": self.accelerations.tolist(),
            "half_exposures": self.half_exposures.tolist(),
            "velocities": _listed(self.velocities),
            "scenes": {name: scene_to_dict(scene) for name, scene in self.scenes.items()},
            "named_scenes": self.named_scenes,
            "shutters": {name: _described(shutter) for name, shutter in self.shutters.items()},
            "metrics": list(self.metrics),
            "photon_rates": _listed(self.photon_rates),
            "read_noises": _listed(self.read_noises),
            "full_well": self.full_well,
            "search": search,
            "block_shape": list(self.block_shape),
        }

    @property
    def key(self) -> str:
        """A short text that differs between sweeps that differ."""
        return hashlib.sha256(json.dumps(self.describe(), sort_keys=True).encode()).hexdigest()


@np.errstate(over="ignore")
def outside_limits(
    frame: Frame, accelerations: Float[np.ndarray, "a"], half_exposures: Float[np.ndarray, "t"]
) -> UInt[np.ndarray, "a t"]:
    """Bits of `REASONS` of the motion's limits at every point."""
    a, half = accelerations[:, None], half_exposures[None]
    demands = frame.scene.limits.demands_of_parabolas(a, half, np.asarray(frame.velocity))
    bits = np.zeros((a.size, half.size), MARKS)
    for reason, demand in demands.items():
        is_beyond = np.logical_not(demand.is_met(1e-9))
        bits |= is_beyond.astype(MARKS) << REASONS.index(reason)
    return bits


def require_within(
    subject: str, frames: Sequence[Frame], accelerations: np.ndarray, half_exposures: np.ndarray
) -> None:
    """Refuse a grid of which no point is within the limits, by the limits that it breaks."""
    outside = [outside_limits(frame, accelerations, half_exposures) for frame in frames]
    require_some_inside(subject, np.stack(outside))


def require_some_inside(subject: str, outside: np.ndarray) -> None:
    """Refuse a grid all of whose points are left out, by the reasons for that."""
    counts = {
        reason.replace("_", " "): int(np.count_nonzero(outside & (1 << bit)))
        for bit, reason in enumerate(REASONS)
    }
    broken = ", ".join(f"{count} by {reason}" for reason, count in counts.items() if count)
    if np.all(outside):
        raise ValueError(
            f"{subject} must reach a point within the scene's limits; "
            f"got {outside.size} outside them, {broken}."
        )


def checked_axis(
    name: str, values: RowLike, *, bound: str = "", strict: bool = False
) -> Float[np.ndarray, "n"]:
    """One axis of `sweep`: at least one finite value, ascending, in its range if it has one."""
    subject = f"sweep({name}=...)"
    try:
        axis = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        got = describe(values)
        raise ValueError(f"`{subject}` must be one row of numbers; got {got}.") from None
    require(axis.ndim == 1, subject, "be one row", shape_of(axis))
    require(axis.size >= 1, subject, "hold at least one value", "none")
    require(bool(np.all(np.isfinite(axis))), subject, "be finite", axis)
    is_inside = axis > 0 if strict else axis >= 0
    require(not bound or bool(np.all(is_inside)), subject, f"be {bound}", axis)
    require(bool(np.all(np.diff(axis) > 0)), subject, "ascend without repeats", axis)
    return axis


def _listed(values: np.ndarray | None) -> list[float] | None:
    return None if values is None else values.tolist()


def _described(shutter: AbstractShutter) -> dict[str, object]:
    """Parameters of a shutter of the package; samples of any other."""
    try:
        return shutter_to_dict(shutter)
    except ValueError:
        tau = np.linspace(-1, 1, 257).astype(common_dtype())
        samples = np.asarray(shutter.transmittance(tau), np.float64)
        return {"kind": type(shutter).__qualname__, "transmittance": samples.tolist()}
