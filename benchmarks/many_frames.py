"""How much do frames lose that stay on a path of few numbers, as more than 24 do?

The search gives each of up to 24 frames numbers of its own, and keeps more on paths of few
numbers, since every further number makes each step of a climb dearer. Climbs here are the search's
own, of as many frames with and without numbers of their own, and of 24 that have them; none goes on
to other orders, which would take hours.
"""

import sys
import time
from typing import Any, cast

import jax
import numpy as np

from benchmarks import harness
from benchmarks.bursts_search import room_of, told
from mishutter import BurstMode, Limits, Scene
from mishutter.search.frame_levels import Levels, Shape
from mishutter.search.frame_search import Descent, one_by_one, shaken
from mishutter.search.frame_ties import BRACKETED, MOST_FREE, STILLS, WAYS, Tie

_STARTS = 4
"""Paths of few numbers, the best first, near which frames of their own numbers begin."""
TEXT = """## More frames than have numbers of their own

PSNR, dB, of the best of {limit} and more frames by climbs of the search: on paths of few numbers,
on which more than {limit} stay, with numbers of their own, and of {limit} that have them. Things
move at either speed of the first row, and at 9 or 17 of the ranges of the others. Other orders of
frames are not tried.

{table}
"""
COLUMNS = (
    "things",
    "frames",
    "of few numbers, dB",
    "of their own numbers, dB",
    f"{MOST_FREE} of their own numbers, dB",
)


def scene_of(
    speeds: Any, light: tuple[float, float], burst: tuple[int, int], limits: tuple[float, ...]
) -> Scene:
    """A scene by its speeds, light and noise, frames, and travel, top speed and acceleration."""
    (rate, noise), (per_s, count), (travel, top, most) = light, burst, limits
    return Scene(
        np.asarray(speeds, np.float64),
        photon_rate=rate,
        read_noise=noise,
        limits=Limits(
            max_stroke=travel,
            max_travel=travel,
            max_top_speed=top,
            max_acceleration=most,
            max_half_exposure=0.04,
        ),
        burst=BurstMode(frames_per_s=per_s, max_frames=count, window=(count + 0.5) / per_s),
    )


SCENES = {
    "-1,200 and 3,000 px/s, at 120/s": scene_of(
        [-1200.0, 3000.0], (1e5, 3.0), (120, 25), (60.0, 6000.0, 2e6)
    ),
    "4,560 to 5,040 px/s, at 120/s": scene_of(
        np.linspace(4560, 5040, 9), (1.8e5, 2.0), (120, 30), (87.0, 11594.0, 4.26e6)
    ),
    "up to 4,500 px/s both ways, at 200/s": scene_of(
        np.linspace(-4500, 4500, 17), (1e5, 4.0), (200, 32), (72.0, 1e4, 2.27e6)
    ),
    "1,800 to 2,200 px/s, at 300/s": scene_of(
        np.linspace(1800, 2200, 9), (3e5, 2.0), (300, 36), (40.0, 6000.0, 4e6)
    ),
}


def climbs(scene: Scene, count: int) -> tuple[float, float]:
    """Levels of the best of so many frames, on paths of few numbers and with their own; dB."""
    speeds = np.asarray(scene.speeds, np.float64)
    slowest, fastest = float(speeds.min()), float(speeds.max())
    room, shape = room_of(scene), Shape(count, 1, 1)
    levels, draw = Levels.on_axis(scene), np.random.default_rng(count)
    descent, line = Descent(levels, room, shape), (slowest, fastest, np.ones(1), np.zeros(1))
    ties = [Tie(kind, room, shape, *line) for kind in (STILLS, BRACKETED, *WAYS)]
    tied = [descent.best(tie, tie.starts) for tie in ties if tie.exists]
    near = sorted((end for end in tied if end is not None), key=lambda end: -end.level)
    starts = [end.frames for end in near[:_STARTS]]
    starts.append(one_by_one(levels, room, shape, (*speeds.tolist(), 0.0)))
    free = [descent.free(shaken(start, draw, room, 0.01)) for start in starts]
    return told(scene, tied), told(scene, free)


def measured(name: str) -> dict[str, Any]:
    """A row of the table."""
    scene, begun = SCENES[name], time.process_time()
    count = cast(BurstMode, scene.burst).max_frames or MOST_FREE
    every = [*climbs(scene, count), climbs(scene, MOST_FREE)[1]]
    row = {"things": name, "frames": count, "seconds": time.process_time() - begun}
    print(f"{name}: {every}, {row['seconds']:.0f} processor seconds", file=sys.stderr, flush=True)
    return row | dict(zip(COLUMNS[2:], every, strict=True))


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = [measured(name) for name in SCENES]
    harness.write("many_frames", rows)
    shown = [row | {name: f"{row[name]:.1f}" for name in COLUMNS[2:]} for row in rows]
    table = harness.table(shown, list(COLUMNS))
    harness.section("many_frames", TEXT.format(limit=MOST_FREE, table=table))


if __name__ == "__main__":
    main()
