"""Rows of a comparison with levels of a test's own, and the verdict on them."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mishutter import (
    Comparison,
    FreeMotion,
    HannShutter,
    LinearMotion,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    TimedFrame,
    evaluate,
)
from mishutter.model.exposures import Exposures
from mishutter.model.motion import AbstractMotion
from mishutter.report.comparison import with_verdict
from mishutter.search.rivals import (
    BEST_CODED_STILL,
    BEST_STILL_BURST,
    CODED_AT_REST,
)
from mishutter.search.rows import (
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    FRAMES,
    ONE_EXPOSURE,
    OWN_BEST_MOTION,
    Row,
)
from support.designs import MOTION, SCENE

SHORT = eqx.tree_at(lambda each: each.limits.max_half_exposure, SCENE, np.asarray(0.012))
"""A scene whose longest exposure has room for one plain still alone."""
STILL = StillCamera(half_exposure=1.3e-3)
PANNED = LinearMotion(half_exposure=2e-3, velocity=-1500.0)
MOVING = ParabolicMotion(acceleration=21.875 / 1e-4, half_exposure=1e-2, velocity=-12345.0)
FREE = FreeMotion(accelerations=[1e5, 3e5, 1e5], half_exposure=1e-2)
ON_FREE_PATH = "of mine, on a free path"
OF_THEIR_KIND = {
    ON_FREE_PATH: (FREE, RectShutter()),
    BEST_SNAPSHOT: (STILL, RectShutter()),
    BEST_PANNED_SNAPSHOT: (PANNED, RectShutter()),
    BEST_CODED_STILL: (PANNED, HannShutter()),
    CODED_AT_REST: (STILL, HannShutter()),
    "rect": (MOVING, RectShutter()),
}


def made_up(levels: dict[str, float]) -> list[Row]:
    """Rows of these expected PSNR, on the motions of their kind, others on one that moves."""
    metrics = evaluate(SCENE, MOTION, HannShutter())
    return [
        Row(
            OWN_BEST_MOTION,
            name,
            Exposures.of_one(motion, shutter),
            0.25,
            replace(metrics, expected_psnr=jnp.asarray(level), efficiency=shutter.efficiency()),
            hardware=ONE_EXPOSURE | {FRAMES} if name == BEST_STILL_BURST else ONE_EXPOSURE,
        )
        for name, level in levels.items()
        for motion, shutter in [OF_THEIR_KIND.get(name, (MOTION, HannShutter()))]
    ]


def changed(row: Row, **parts: object) -> Row:
    """A row of which some parts are others, or the motion, the shutter or the pan of its camera."""
    own = {name: parts.pop(name) for name in ("shutter", "pan") if name in parts}
    if "motion" in parts:
        own["frames"] = (TimedFrame(parts.pop("motion"), 0.0),)
    exposures = replace(parts.pop("exposures", row.exposures), **own)
    return replace(row, exposures=exposures, **parts)


def turned(rows: list[Row]) -> list[Row]:
    """Rows of cameras that turn to pan, which their stages do not."""
    return [changed(row, pan=float(row.motion.velocity)) for row in rows]


def verdict(levels: dict[str, float], *names: str, scene: Scene = SCENE) -> Comparison:
    """The comparison of such rows, of which these are the user's own."""
    return with_verdict(made_up(levels), dict.fromkeys(names, RectShutter()), scene)


def sequence(motion: AbstractMotion, num_frames: int, travel: float = 0.0) -> Exposures:
    """Frames that are alike, 30 ms from one to the next, of a level that no test reads."""
    frames = tuple(TimedFrame(motion, 0.03 * k) for k in range(num_frames))
    return Exposures("made up", frames, travel, 30.0, 29.0)
