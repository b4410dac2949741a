"""What do occlusion edges cost frames before a background, at rest and moving?

Three objects move in front of a background at rest. A decoder that knows their velocities and
outlines restores each layer from all frames: what the others hide of it, and what they show in its
place, is replaced by what the layers restored so far predict, until that changes little.
"""

import sys

import jax
import numpy as np
from scipy.ndimage import gaussian_filter

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.evaluation.bursts import best_still_burst
from mishutter.pictures.images import Picture, shipped_picture
from mishutter.search.moving_frames import best_moving_burst

SIZE, BORDER = 256, 48
"""Rows and columns of a picture, and columns at either end that are not judged; px."""
OBJECTS = ((130, 60, 20, 40, 1140.0), (100, 70, 100, 110, -640.0), (72, 60, 185, 70, 250.0))
"""Width, height, top and left of ellipses, px, and their speeds, px/s."""
NUM_PHOTOGRAPHS, NUM_ROUNDS = 6, 8
TEXT = """## Occlusion edges and frames

Four frames of {count} photographs, {size} x {size} px, before each of which details of three others
move as ellipses of 72 to 130 px at 250 to 1,140 px/s, a fifth of the picture, at 1e5 e-/s and 8 e-.
PSNR, dB, restored by a decoder that knows velocities and outlines, and without edges: each part of
the picture as if its layer were all that is seen. The formula's levels, with what edges cost, are
{still:.2f} dB for the best stills and {moving:.2f} dB for the best moving frames of such a scene.

{table}"""


def camera(occlusion: ms.Occlusion | None = None) -> ms.Scene:
    """A camera of 50 frames/s in dim light."""
    return ms.Scene.uniform(
        max_speed=1140.0,
        num_speeds=9,
        photon_rate=1e5,
        read_noise=8,
        limits=ms.Limits(max_stroke=60, max_half_exposure=0.01),
        burst=ms.BurstMode(frames_per_s=50, max_frames=4, window=0.08),
        occlusion=occlusion,
        decoder_speed="known",
    )


def mattes() -> list[np.ndarray]:
    """Opacities of the objects, whose edges are some pixels wide."""
    shapes = []
    for width, height, *_ in OBJECTS:
        down, right = np.mgrid[:height, :width]
        across = (right - (width - 1) / 2) / (width / 2 - 3)
        along = (down - (height - 1) / 2) / (height / 2 - 3)
        shapes.append(gaussian_filter((across**2 + along**2 <= 1).astype(float), 1.0))
    return shapes


def layered(lights: list[np.ndarray], shapes: list[np.ndarray]) -> ms.Layers:
    """Layers of a background and of what lies under the mattes of the others."""
    objects = [
        ms.Layer(
            Picture(light[top : top + height, left : left + width, None], matte),
            speed,
            left=left,
            top=top,
        )
        for light, matte, (width, height, top, left, speed) in zip(
            lights[1:], shapes, OBJECTS, strict=True
        )
    ]
    return ms.Layers((ms.Layer(Picture(lights[0][..., None])), *objects))


def shares_of(shapes: list[np.ndarray]) -> np.ndarray:
    """The share of each layer in each pixel, halfway through the frames."""
    shares = np.zeros((1 + len(OBJECTS), SIZE, SIZE))
    for share, matte, (width, height, top, left, _) in zip(
        shares[1:], shapes, OBJECTS, strict=True
    ):
        share[top : top + height, left : left + width] = matte
    shares[0] = 1 - shares[1:].sum(axis=0)
    return shares


def errors_of(
    lights: list[np.ndarray], shapes: list[np.ndarray], frames: tuple, key: jax.Array
) -> tuple[float, float]:
    """Mean squared errors with edges and without them."""
    scene, shares = camera(), shares_of(shapes)
    speeds = [0.0, *(speed for *_, speed in OBJECTS)]

    def restored(captures: np.ndarray, speed: float) -> np.ndarray:
        light = ms.restore_frames(captures, scene, frames, speed=speed).light
        return np.clip(np.asarray(light), 0, 1)

    def whole(light: np.ndarray, speed: float, key: jax.Array | None = None) -> np.ndarray:
        return np.asarray(ms.simulate_frames(light, scene, frames, speed=speed, key=key))

    def error(found: list[np.ndarray]) -> float:
        left = np.sum(shares * (np.array(found) - np.array(lights)), axis=0)
        return float(np.mean(left[:, BORDER:-BORDER] ** 2))

    taken = np.asarray(ms.simulate_frames(layered(lights, shapes), scene, frames, key=key))[..., 0]
    found = [restored(taken, speed) for speed in speeds]
    for _ in range(NUM_ROUNDS):
        seen = np.asarray(ms.simulate_frames(layered(found, shapes), scene, frames))[..., 0]
        found = [
            restored(taken - seen + whole(light, speed), speed)
            for light, speed in zip(found, speeds, strict=True)
        ]
    alone = [
        restored(whole(light, speed, key), speed)
        for light, speed in zip(lights, speeds, strict=True)
    ]
    return error(found), error(alone)


def bursts_of(occlusion: ms.Occlusion) -> dict[str, tuple]:
    """Four frames of each kind: those of the formula, and equal ones."""
    still, moving = best_still_burst(camera(occlusion)), best_moving_burst(camera(occlusion))
    if still is None or moving is None:
        raise RuntimeError("the camera takes no burst")
    long, short, shorter = (ms.StillCamera(half_exposure=half) for half in (0.01, 0.002, 0.0015))
    parabola = ms.ParabolicMotion(acceleration=7.5 / 0.01**2, half_exposure=0.00999)
    times = (-0.03, -0.01, 0.01, 0.03)
    mixed = (shorter, parabola, parabola, parabola)
    orders = {
        "3, 20, 20, 3": (1, 0, 0, 1),
        "20, 3, 20, 3": (0, 1, 0, 1),
        "20, 20, 3, 3": (0, 0, 1, 1),
    }
    paired = {
        f"stills of {name} ms": tuple(
            ms.TimedFrame((long, shorter)[k], time) for k, time in zip(order, times, strict=True)
        )
        for name, order in orders.items()
    }
    return paired | {
        still.text: still.frames,
        moving.text: moving.frames,
        "stills of 4 ms": tuple(ms.TimedFrame(short, time) for time in times),
        "one still of 3 ms, three parabolas of 20 ms": tuple(
            ms.TimedFrame(motion, time) for motion, time in zip(mixed, times, strict=True)
        ),
    }


def measure() -> list[dict]:
    """A row for each burst and photograph."""
    jax.config.update("jax_enable_x64", True)
    shapes = mattes()
    share = sum(matte.sum() for matte in shapes) / SIZE**2
    squares = []
    for name in PHOTOGRAPHS:
        light = np.asarray(shipped_picture(name).luminance, float)
        down, right = ((side - SIZE) // 2 for side in light.shape)
        squares.append((name, light[down : down + SIZE, right : right + SIZE]))
    bursts = bursts_of(ms.Occlusion(front_share=share, object_width=85.0))
    step = len(squares) // NUM_PHOTOGRAPHS
    rows = []
    for first in range(0, step * NUM_PHOTOGRAPHS, step):
        chosen = [squares[(first + k) % len(squares)] for k in range(1 + len(OBJECTS))]
        for kind, frames in bursts.items():
            lights = [light for _, light in chosen]
            edges, none = errors_of(lights, shapes, frames, jax.random.key(first))
            row = {"frames": kind, "photograph": chosen[0][0]}
            rows.append(row | {"psnr": decibels(edges), "without edges": decibels(none)})
    return rows


def table_of(rows: list[dict]) -> list[dict]:
    """Mean levels of each kind of burst."""
    table = []
    for kind in dict.fromkeys(row["frames"] for row in rows):
        those = [row for row in rows if row["frames"] == kind]
        edges, none = (np.mean([row[name] for row in those]) for name in ("psnr", "without edges"))
        cells = {"with edges": f"{edges:.2f}", "without": f"{none:.2f}"}
        table.append({"four frames": kind} | cells | {"cost": f"{none - edges:.2f}"})
    return table


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("layered_bursts", rows)
    share = sum(matte.sum() for matte in mattes()) / SIZE**2
    scene = camera(ms.Occlusion(front_share=share, object_width=85.0))
    still, moving = best_still_burst(scene), best_moving_burst(scene)
    table = harness.table(table_of(rows), ["four frames", "with edges", "without", "cost"])
    levels = {
        name: float("nan") if burst is None else burst.psnr
        for name, burst in (("still", still), ("moving", moving))
    }
    text = TEXT.format(count=NUM_PHOTOGRAPHS, size=SIZE, table=table, **levels)
    harness.section("layered_bursts", text)


if __name__ == "__main__":
    sys.exit(main())
