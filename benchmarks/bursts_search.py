"""Does a long search find better frames than the short one of the package, on 60 random scenes?

The package begins from frames of few numbers that have a name. The long search knows no names: it
begins many times from frames at random, each as near to them as the limits allow, and then again
and again from near the best that it has. Its descents are the package's, so that what it shows is
whether starts were missing. What the package answers is judged by code of its own: the level from
its formula, by quadrature over each exposure, and the limits on a path that is sampled.

`python -m benchmarks.bursts_search LOG keep` searches by the package again, and long again only
where the package's level is no longer the stored one or the stored gain was large.
"""

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np
from jaxtyping import Float

from benchmarks import harness
from mishutter import BurstMode, Exposures, Limits, Scene
from mishutter.evaluation.bursts import FrameTimes
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import Descent, End, best_of, shaken
from mishutter.search.moving_frames import best_moving_burst, levels_of, sequence_of

NUM_SCENES = 60
NUM_RANDOM, NUM_AGAIN = 16, 12
"""Descents from frames at random, and from near the best."""
ALLOWED = 0.05
"""How much better frames the long search may find; dB."""
LARGE, SAME = 0.03, 0.001
"""Gain from which, and change of the package's level up to which, a stored end is kept; dB."""
MEAN, CONTRAST, CORNER = 0.25, 0.2, 0.01
"""Of a scene's picture, by default."""
COLUMNS = (
    "scene",
    "frames",
    "kind",
    "package, dB",
    "long, dB",
    "gain, dB",
    "package, s",
    "long, s",
)
TEXT = """## A long search for frames

PSNR, dB, of the frames that the package answers on {count} random scenes (one way, both ways, two
speeds, unequal weights; tight and loose stages, 2 to 12 frames, 2 to 10 e-, 15 to 200 frames/s),
and of the best of {descents} descents from frames at random and from near the best of these. The
level of the long search less that of the package is {mean:+.3f} dB in the mean, {worst:+.3f} at
least and {most:+.3f} at most; it is above {allowed:.2f} dB, which is allowed, in: {over}. Where
both ran, in {both} scenes, the package took {own:.0f} s of processor time and the long search
{seconds:.0f} s (load {load:.0f} on {cores} cores when written). Levels by quadrature differ from
those told by {error:.0e} dB at most, and no sampled path takes more than {share:.4f} of a limit.
{kept}
{table}
"""

KEPT = """In {count} scenes the end of the long search is that of an earlier run: the level of
the package there is the same to {same} dB, and the long search was {large} dB better at most; no
time is given for these.
"""


def scene_of(index: int) -> Scene:
    """A scene at random; its kind goes by its number."""
    draw = np.random.default_rng([29, index])
    way = ("one way", "both ways", "two speeds", "unequal weights")[index % 4]
    fastest = float(np.exp(draw.uniform(np.log(300), np.log(6000))))
    weights = None
    if way == "one way":
        speeds = np.linspace(draw.uniform(0.1, 0.95) * fastest, fastest, 9)
    elif way == "both ways":
        speeds = np.linspace(-fastest, fastest, 9)
    elif way == "two speeds":
        speeds = np.array([-draw.uniform(0, 1), 1.0]) * fastest
        speeds = np.abs(speeds) if draw.random() < 0.5 else speeds
        weights = draw.dirichlet([3, 3])
    else:
        speeds = np.sort(draw.uniform(-1, 1, 5)) * fastest
        weights = draw.dirichlet(np.ones(5))
    is_tight, count = draw.random() < 0.5, int(draw.integers(2, 13))
    top = fastest * draw.uniform(1.2, 3.0)
    rate = float(np.exp(draw.uniform(np.log(15), np.log(200))))
    travel = float(draw.uniform(8, 90))
    limits = Limits(
        max_stroke=travel,
        max_travel=travel,
        max_top_speed=top,
        max_acceleration=top**2 / travel * (draw.uniform(1, 4) if is_tight else 50.0),
        min_half_exposure=1e-4,
        max_half_exposure=0.04,
    )
    burst = BurstMode(frames_per_s=rate, max_frames=count, window=(count + 0.5) / rate)
    electrons, noise = float(np.exp(draw.uniform(np.log(2e4), np.log(1e6)))), draw.uniform(2, 10)
    return Scene(
        speeds, weights=weights, photon_rate=electrons, read_noise=noise, limits=limits, burst=burst
    )


def at_random(room: Room, shape: Shape, scene: Scene, draw: np.random.Generator) -> Frames:
    """Frames of random lengths and velocities, each of things of the scene or at rest."""
    speeds, count = np.append(np.asarray(scene.speeds), 0.0), shape.number
    most = min(room.times.longest, room.times.window / count)
    exposure = most * np.exp(draw.uniform(np.log(0.05), 0.0, count))
    own = draw.choice(speeds, (count, 1)) + draw.choice([0.0, 0.3, 1.0]) * draw.normal(
        0, room.speed, (count, 2)
    )
    velocity = np.linspace(own[:, 0], own[:, 1], shape.pieces + 1, axis=1)[..., None]
    least = max(room.times.dead_time, 1e-2 * room.times.period)
    gap = np.maximum(room.times.period - exposure[1:], least)
    place = draw.uniform(0, room.stroke, (count, 1))
    return Frames(exposure, velocity, gap, place, np.zeros(1))


def long_search(scene: Scene, count: int, seed: int) -> tuple[float, int]:
    """The level that is told of the best frames, and the number of descents."""
    draw, room = np.random.default_rng(seed), room_of(scene)
    found: list[End | None] = []
    for number in sorted({count, max(2, round(0.8 * count)), max(2, count // 2)}):
        shape = Shape(number, 2 if number <= 3 else 1, 1)
        descent = Descent(Levels.on_axis(scene), room, shape)
        found += [
            descent.free(at_random(room, shape, scene, draw))
            for _ in range(NUM_RANDOM if number == count else NUM_RANDOM // 2)
        ]
    for _ in range(NUM_AGAIN):
        top = best_of(found)
        if top is None:
            break
        descent = Descent(Levels.on_axis(scene), room, top.frames.shape)
        share, longer = draw.choice([0.02, 0.1, 0.4], 2)
        found.append(descent.free(shaken(top.frames, draw, room, share, longer)))
    return told(scene, found), len(found)


def told(scene: Scene, ends: Sequence[End | None]) -> float:
    """The best level of some ends, as it is told; dB."""
    each = (sequence_of(end.frames, end.kind) for end in ends if end is not None)
    return max((levels_of(scene, frames.along)[0] for frames in each), default=-np.inf)


def room_of(scene: Scene) -> Room:
    """The room that a scene's stage and its times leave to frames."""
    fastest = float(np.max(np.abs(np.asarray(scene.speeds))))
    return Room.of(scene.limits, FrameTimes.of(scene, cast(BurstMode, scene.burst)), fastest)


def by_quadrature(scene: Scene, sequence: Exposures) -> float:
    """The level of frames from its formula; dB."""
    u = (np.arange(768) + 0.5) / 768
    f, step = u**2 / 2, 2 * u / 2 / 768
    band = (np.arange(8192) + 0.5) / 16384
    power = CONTRAST**2 / np.mean(1 / (band**2 + CORNER**2)) / (f**2 + CORNER**2)
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    gained = 0.0
    for frame in sequence.along:
        electrons = frame.exposure * float(scene.photon_rate)
        noise = MEAN / electrons + (float(scene.read_noise) / electrons) ** 2
        gained += np.abs(transfer(frame, f, speeds)) ** 2 / noise
    left = power / (1 + power * np.sinc(f) ** 2 * gained)
    return float(-10 * np.log10(weights / weights.sum() @ (left @ (2 * step))))


def transfer(frame: Any, f: Float[np.ndarray, "m"], speeds: Any) -> Any:
    """Response of a frame by speed and frequency."""
    x, w = np.polynomial.legendre.leggauss(24)
    ends = np.linspace(-1, 1, 49)
    tau = np.ravel((ends[1:, None] + ends[:-1, None] + (ends[1] - ends[0]) * x) / 2)
    weight, half = np.tile(w, 48) / 96, frame.exposure / 2
    place = np.asarray(frame.motion.position(half * tau), np.float64)
    ways = place - speeds[:, None] * half * tau
    return np.stack([np.exp(-2j * np.pi * np.outer(f, way)) @ weight for way in ways])


def share_of_limits(scene: Scene, sequence: Exposures) -> float:
    """The largest share of a limit that a sampled path takes, from rest to rest."""
    path, limits = sequence.stage_paths_within(scene.limits).get(""), scene.limits
    if path is None:
        return 0.0
    time = np.linspace(path.times[0], path.times[-1], 200_001)
    place = path.at(time)[0]
    velocity = np.diff(place) / np.diff(time)
    # A step that a corner of the velocity is in has part of the change of each side.
    change = np.abs(np.diff(velocity)) / (time[1] - time[0])
    shares = (
        np.ptp(place) / float(np.asarray(limits.max_travel)),
        np.max(np.abs(velocity)) / float(limits.max_top_speed),
        np.max(change) / float(np.asarray(limits.max_acceleration)),
    )
    return float(max(shares))


def measured(index: int, stored: dict[str, Any] | None) -> dict[str, Any]:
    """Both searches of one scene, or the package's and the long one's end that is stored."""
    scene, begun = scene_of(index), time.process_time()
    ours = cast(Exposures, best_moving_burst(scene))
    own, begun = time.process_time() - begun, time.process_time()
    is_kept = stored is not None and (
        abs(ours.psnr - stored["package, dB"]) <= SAME and stored["gain, dB"] <= LARGE
    )
    if stored is not None and is_kept:
        level, descents, spent = stored["long, dB"], stored["descents"], None
    else:
        level, descents = long_search(scene, cast(BurstMode, scene.burst).max_frames or 2, index)
        spent = time.process_time() - begun
    return {
        "scene": index,
        "frames": ours.num_frames,
        "kind": ours.kind,
        "package, dB": ours.psnr,
        "long, dB": level,
        "gain, dB": level - ours.psnr,
        "package, s": own,
        "long, s": spent,
        "descents": descents,
        "error": abs(by_quadrature(scene, ours) - ours.psnr),
        "share": share_of_limits(scene, ours),
    }


def main(*arguments: str) -> None:
    """Measure, store and print; a file given holds the scenes that are done, and goes on."""
    jax.config.update("jax_enable_x64", True)
    log, is_again = Path(arguments[0]) if arguments else None, "keep" in arguments[1:]
    file = harness.RESULTS / "bursts_search.json"
    before = json.loads(file.read_text("utf-8"))["rows"] if is_again else []
    stored = {row["scene"]: row for row in before}
    lines = log.read_text("utf-8").splitlines() if log is not None and log.exists() else []
    rows = [json.loads(line) for line in lines]
    for index in sorted({*range(NUM_SCENES)} - {row["scene"] for row in rows}):
        rows.append(measured(index, stored.get(index)))
        print(rows[-1], flush=True)
        if log is not None:
            with log.open("a", encoding="utf-8") as end:
                end.write(json.dumps(rows[-1], default=float) + "\n")
    rows.sort(key=lambda row: row["scene"])
    harness.write("bursts_search", rows)
    gains = np.array([row["gain, dB"] for row in rows])
    both = [row for row in rows if row["long, s"] is not None]
    machine, kept = harness.environment(), len(rows) - len(both)
    shown = [{k: f"{x:.2f}" if isinstance(x, float) else x for k, x in row.items()} for row in rows]
    text = TEXT.format(
        count=len(rows),
        descents=f"{np.mean([row['descents'] for row in rows]):.0f}",
        mean=gains.mean(),
        most=gains.max(),
        worst=gains.min(),
        over=", ".join(f"scene {row['scene']}" for row in rows if row["gain, dB"] > ALLOWED)
        or "none",
        allowed=ALLOWED,
        both=len(both),
        own=sum(row["package, s"] for row in both),
        seconds=sum(row["long, s"] for row in both),
        load=machine["load"],
        cores=machine["cores"],
        error=max(row["error"] for row in rows),
        share=max(row["share"] for row in rows),
        kept=KEPT.format(count=kept, same=SAME, large=LARGE) if kept else "",
        table=harness.table(shown, list(COLUMNS)),
    )
    harness.section("bursts_search", text)


if __name__ == "__main__":
    main(*sys.argv[1:])
