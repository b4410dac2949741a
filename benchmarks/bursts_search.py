"""Can a search that shares no code with the package find better bursts than it does?

The level is written anew from its formula, in NumPy, with parabolas in closed form. Paths are
velocities over the whole burst, of which travel, speed and acceleration are sampled, and so may
hold a pan that the package's bounds rule out. Random points are screened and the best of them
improved by simplexes, for fewer frames too, for any pan, for each kind of path and with some
frames at rest before it. Of the package only the numbers of a `Scene` are read.
"""

import itertools
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.special import fresnel

from benchmarks import harness
from mishutter import BurstMode, FrameSequence, Limits, Occlusion, Scene
from mishutter.evaluation.bursts import best_still_burst
from mishutter.search.moving_frames import best_moving_burst

ALLOWED = 0.01 + 0.05
"""How much better than the package's a burst may be: that it finds, and that is less simple; dB."""
NUM_SCREENED, NUM_DESCENTS, NUM_STEPS = 60, 2, 120
NUM_FREQUENCIES, SEARCHED = 512, 96
"""Frequencies of the levels that count, and of the search."""
NODES_OF_SINE = np.polynomial.legendre.leggauss(128)
NUM_TIMES = 200
"""Times within a period at which a path is sampled."""
MEAN, CONTRAST, CORNER = 0.25, 0.2, 0.01
"""Of a scene's picture, by default."""
COLUMNS = ("scene", "still", "found still", "moving", "kind", "found moving", "its kind", "lead")
TEXT = """## An independent search for bursts

PSNR, dB, of the best bursts of a sensor at rest and of one that moves, and of what a search that
shares no code with the package finds with as many frames or fewer, with any pan, with any number
of frames at rest, and with frames that wait for each other. The lead is the larger of the two
differences: at most {largest:+.4f} dB ({allowed:.2f} is allowed, 0.05 of it for a burst that is
simpler than the best). The package took
{own:.0f} s and the other search {seconds:.0f} s.

{table}
"""


class Footage(NamedTuple):
    """Frames that are alike but for their velocity; `amplitude` is that of a sine, or None."""

    half: float
    acceleration: float = 0.0
    velocities: Any = (0.0,)
    number: float = 1.0
    amplitude: float | None = None
    period: float = 1.0


class Camera(NamedTuple):
    """The numbers of a scene."""

    scene: Scene
    burst: Any
    speeds: Float[np.ndarray, "n"]
    weights: Float[np.ndarray, "n"]
    period: float
    window: float
    stroke: float
    travel: float
    acceleration: float

    @staticmethod
    def of(scene: Scene) -> "Camera":
        """Those of a scene whose background, if any, is at rest."""
        limits, layers = scene.limits, scene.occlusion
        burst: Any = scene.burst
        speeds, weights = np.array(scene.speeds, float), np.array(scene.weights, float)
        weights = weights / weights.sum()
        if layers is not None:
            share = float(layers.front_share)
            speeds = np.append(speeds, 0.0)
            weights = np.append(share * weights, 1 - share)
        window = 2 * limits.max_half_exposure if burst.window is None else burst.window
        return Camera(
            scene,
            burst,
            speeds,
            weights,
            1 / float(burst.frames_per_s),
            float(window),
            float(limits.max_stroke),
            float("inf" if limits.max_travel is None else limits.max_travel),
            float("inf" if limits.max_acceleration is None else limits.max_acceleration),
        )

    def step(self, exposure: float) -> float:
        """Least time from the end of one frame to that of the next, of some exposure."""
        return max(self.period, exposure + float(self.burst.dead_time))

    def longest(self, count: int, taken: float = 0.0) -> float:
        """Longest exposure of each of some frames, by bisection, where others take some time."""
        low, high = 0.0, 2 * float(self.scene.limits.max_half_exposure)
        if count == 1 and not taken:
            return high

        def fits(exposure: float) -> bool:
            first = self.step(exposure) if taken else exposure
            return taken + first + (count - 1) * self.step(exposure) <= self.window

        if fits(high):
            return high
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if fits(middle) else (low, middle)
        return low

    @property
    def shortest(self) -> float:
        """Shortest exposure."""
        return 2 * float(self.scene.limits.min_half_exposure)

    def error(self, frames: list[Footage], num_frequencies: int = SEARCHED) -> float:
        """What the frames leave; white = 1."""
        u = (np.arange(num_frequencies) + 0.5) / num_frequencies
        f, step = u**2 / 2, 2 * u / num_frequencies
        band = (np.arange(8192) + 0.5) / 16384
        power = CONTRAST**2 / np.mean(1 / (band**2 + CORNER**2)) / (f**2 + CORNER**2)
        gained = 0.0
        for each in frames:
            electrons = 2 * each.half * float(self.scene.photon_rate)
            noise = MEAN / electrons + (float(self.scene.read_noise) / electrons) ** 2
            for velocity in each.velocities:
                gained += each.number / noise * passed(each, f, self.speeds - velocity)
        left = power / (1 + power * np.sinc(f) ** 2 * gained)
        return float(self.weights @ (left @ step))

    def level(self, frames: list[Footage]) -> float:
        """Their level; dB."""
        return -10 * np.log10(self.error(frames, NUM_FREQUENCIES))


def passed(frame: Footage, f: Float[np.ndarray, "m"], speeds: Any) -> Float[np.ndarray, "n m"]:
    """|H|^2 of an open frame, by relative speed and frequency."""
    half, a, speeds = frame.half, abs(frame.acceleration), speeds[:, None]
    if frame.amplitude is not None:
        x, w = NODES_OF_SINE
        place = frame.amplitude * (1 - np.cos(np.pi * half * x / frame.period))
        waves = np.exp(-2j * np.pi * f[:, None] * place) * (w / 2)
        ways = np.exp(2j * np.pi * half * x[:, None, None] * f * speeds)
        return np.abs(np.einsum("fx,xsf->sf", waves, ways, optimize=True)) ** 2
    at_rest = np.sinc(2 * half * f * speeds) ** 2
    if a * half**2 < 1e-3:
        return at_rest
    # Places of the ends from the vertex, in the unit of Fresnel's integrals.
    scale = 2 * np.sqrt(f * a)
    ends = [scale * (sign * half - speeds / (2 * a)) for sign in (-1, 1)]
    (s0, c0), (s1, c1) = (fresnel(x) for x in ends)
    return ((s1 - s0) ** 2 + (c1 - c0) ** 2) / (2 * half * scale) ** 2


class Path(NamedTuple):
    """A kind of path: the sensor's velocity at the top speed 1, and the frames it gives."""

    velocity: Callable[..., Any]
    frames: Callable[..., Footage]


def middles(count: int, period: float) -> Float[np.ndarray, "n"]:
    """Mid-exposures of some frames."""
    return (np.arange(count) - (count - 1) / 2) * period


def alternating_velocity(t: Any, count: int, half: float, period: float) -> Any:
    """Up and down in turn, at constant velocity in between."""
    turns = (t - middles(count, period)[0]) / period
    k = np.round(turns)
    return (-1) ** k * np.clip((turns - k) * period / half, -1, 1)


def fan_velocity(t: Any, count: int, half: float, period: float) -> Any:
    """Constant in each frame, evenly from one to the next."""
    times, steps = middles(count, period), np.linspace(-1, 1, count)
    return np.interp(t, np.c_[times - half, times + half].ravel(), np.repeat(steps, 2))


PATHS = {
    "alternating parabolas": Path(
        alternating_velocity,
        lambda v, pan, n, half, period: Footage(half, v / (2 * half), [pan], n),
    ),
    "sine": Path(
        lambda t, n, half, period: np.sin(np.pi * (t - middles(n, period)[0]) / period),
        lambda v, pan, n, half, period: Footage(
            half, 0.0, [pan], n, amplitude=v * period / np.pi, period=period
        ),
    ),
    "sweep": Path(
        lambda t, n, half, period: t / ((n - 1) * period / 2 + half),
        lambda v, pan, n, half, period: Footage(
            half,
            v / ((n - 1) * period + 2 * half),
            pan + v * middles(n, period) / ((n - 1) * period / 2 + half),
        ),
    ),
    "fan of pans": Path(
        fan_velocity,
        lambda v, pan, n, half, period: Footage(half, 0.0, pan + v * np.linspace(-1, 1, n)),
    ),
}


def top_speed(
    camera: Camera, path: Path, pan: float, count: int, half: float, period: float, rests: int
) -> float:
    """The greatest top speed within the limits over the whole burst; below 0 for none."""
    limits, most_of_stage = camera.scene.limits, camera.acceleration
    most = float(limits.max_top_speed) - abs(pan)
    end = (count - 1) * period / 2 + half
    t = np.linspace(-end, end, NUM_TIMES * count + 1)
    velocity = path.velocity(t, count, half, period)
    if most_of_stage < np.inf:
        steepest = np.max(np.abs(np.diff(velocity))) / (t[1] - t[0])
        most = min(most, most_of_stage / max(steepest, 1e-30))
    way = np.r_[0.0, np.cumsum((velocity[1:] + velocity[:-1]) / 2) * (t[1] - t[0])]
    pan = pan if limits.pans == "stage" else 0.0

    def fits(top: float) -> bool:
        lit = top * way + pan * t
        first, last = (pan + top * velocity[k] for k in (0, -1))
        start = lit[0] - first * abs(first) / 2 / most_of_stage
        stop = lit[-1] + last * abs(last) / 2 / most_of_stage
        places = np.r_[start, lit] if rests else lit
        return np.ptp(places) <= camera.stroke and np.ptp(np.r_[start, lit, stop]) <= camera.travel

    if not fits(0.0):
        return -1.0
    low, high = 0.0, most
    for _ in range(0 if fits(most) else 40):
        middle = (low + high) / 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low or high


class Try(NamedTuple):
    """Frames of one kind: so many that move, and some at rest before them."""

    camera: Camera
    kind: str
    num_moving: int
    rests: int = 0

    @property
    def pans(self) -> tuple[float, float]:
        """Least and greatest velocity to pan at: no faster than anything in the picture."""
        limits, speeds = self.camera.scene.limits, [0.0, *self.camera.speeds]
        most = min(float(limits.max_pan), float(limits.max_top_speed))
        if self.rests and limits.pans == "camera":
            most = 0.0
        return max(min(speeds), -most), min(max(speeds), most)

    def frames(self, point: Float[np.ndarray, "5"]) -> list[Footage] | None:
        """Exposure, share of the top speed, pan, exposure at rest, period; None outside limits."""
        camera, count = self.camera, self.num_moving
        if np.any((point < 0) | (point > 1)):
            return None
        shortest, rests = camera.shortest, self.rests
        taken = shortest + (rests - 1) * camera.step(shortest) if rests else 0.0
        longest = camera.longest(count, taken)
        if longest < shortest:
            return None
        exposure = shortest * (longest / shortest) ** point[0]
        half, period = exposure / 2, camera.step(exposure)
        if count > 1:
            first = period if rests else exposure
            most = max((camera.window - taken - first) / (count - 1), period)
            period *= (most / period) ** point[4]
        pan = np.interp(point[2], [0, 1], self.pans)
        path = PATHS[self.kind]
        most = top_speed(camera, path, pan, count, half, period, rests)
        if most < 0:
            return None
        speed = point[1] * most
        frames = [path.frames(speed, pan, count, half, period)]
        if rests:
            t = np.array([-(count - 1) * period / 2 - half])
            start = speed * float(path.velocity(t, count, half, period)[0])
            start += pan if camera.scene.limits.pans == "stage" else 0.0
            gap = max(float(camera.burst.dead_time), abs(start) / camera.acceleration)
            taken = max(camera.period, exposure + gap) + (count - 1) * period
            left = camera.longest(rests, taken)
            if left < shortest:
                return None
            rest = shortest * (left / shortest) ** point[3]
            frames.append(Footage(rest / 2, number=rests))
        return frames

    def best(self, draw: np.random.Generator) -> tuple[float, str]:
        """The level of the best that is found, and its kind."""

        def loss(point: Any) -> float:
            frames = self.frames(np.asarray(point))
            return 1e3 if frames is None else np.log(self.camera.error(frames))

        slowest, fastest = self.pans
        most = (self.num_moving + self.rests - 1) * self.camera.period
        waits = self.num_moving > 1 and most < 0.98 * self.camera.window
        free = [True, True, fastest > slowest, self.rests > 0, waits]

        def place(part: Any) -> Float[np.ndarray, "5"]:
            point = np.array([0.5, 0.5, 0.5, 0.5, 0.0])
            point[free] = part
            return point

        starts = [draw.random(sum(free)) for _ in range(NUM_SCREENED)]
        for start in starts[::3] if fastest > slowest else []:
            start[2] = -slowest / (fastest - slowest)  # without a pan
        for start in starts[1::2] if waits else []:
            start[-1] = 0.0  # at once
        starts = sorted(starts, key=lambda part: loss(place(part)))[:NUM_DESCENTS]
        found = []
        for start in starts:
            end: Any = minimize(
                lambda part: loss(place(part)),
                start,
                method="Nelder-Mead",
                options={"maxfev": NUM_STEPS, "xatol": 1e-3, "fatol": 1e-6},
                bounds=[(0, 1)] * len(start),
            )
            frames = self.frames(place(end.x))
            if frames is not None:
                found.append((self.camera.level(frames), self.words(frames)))
        return max(found, default=(-np.inf, ""))

    def words(self, frames: list[Footage]) -> str:
        """The kind, the exposures and the pan."""
        first, *others = frames
        rest = "".join(
            f" after {self.rests} of {2e3 * each.half:.3g} ms at rest" for each in others
        )
        pan = float(np.mean(first.velocities))
        panned = f", panned at {pan:.0f} px/s" if abs(pan) > 1 else ""
        return f"{self.kind}, {self.num_moving} of {2e3 * first.half:.3g} ms{rest}{panned}"


def moving(camera: Camera, draw: np.random.Generator) -> tuple[float, str]:
    """The best of all kinds."""
    most = camera.burst.max_frames
    numbers = np.unique(np.geomspace(1, most, 9).round().astype(int)).tolist()
    pairs = {
        (moving, rests)
        for moving in numbers
        for count in {moving, most // 2, most - 1, most}
        for rests in [count - moving]
        if rests >= 0
    }
    pairs |= {(moving, 1) for moving in numbers if moving < most}
    tries = [
        Try(camera, kind, moving, rests)
        for moving, rests in sorted(pairs)
        for kind in PATHS
        if moving > (kind != "alternating parabolas") and moving + rests > 1
    ]
    return max(each.best(draw) for each in tries)


def still(camera: Camera) -> tuple[float, str]:
    """The best of a sensor at rest: every number of frames, and every division in two exposures."""
    found = []
    for count in range(2, camera.burst.max_frames + 1):
        if camera.longest(count) < camera.shortest:
            continue
        ends = np.log([camera.shortest, camera.longest(1)])
        for first in range(count // 2 + 1):

            def frames(point: Any, numbers: Any = (first, count - first), ends: Any = ends) -> Any:
                lasting = np.exp(point)
                kinds = [(x, m) for x, m in zip(lasting, numbers, strict=True) if m]
                kinds = sorted(kinds, reverse=True)
                taken = sum(m * camera.step(x) for x, m in kinds)
                taken += kinds[0][0] - camera.step(kinds[0][0])
                is_within = np.all((point >= ends[0]) & (point <= ends[1]))
                if not is_within or taken > camera.window * (1 + 1e-12):
                    return None
                return [Footage(x / 2, number=m) for x, m in kinds]

            def loss(point: Any, frames: Any = frames) -> float:
                found = frames(point)
                return 1e3 if found is None else np.log(camera.error(found))

            inside = np.log(camera.longest(count))
            for start in itertools.product(np.linspace(ends[0], inside, 4), repeat=2):
                end: Any = minimize(
                    loss,
                    start,
                    method="Nelder-Mead",
                    options={"maxfev": NUM_STEPS, "xatol": 1e-3, "fatol": 1e-6},
                )
                if end.fun < 1e3:
                    found.append((camera.level(frames(end.x)), f"{first} + {count - first}"))
    return max(found)


def scenes() -> dict[str, Scene]:
    """Cameras and what they look at."""

    def scene(
        speeds: Any = (-4500, 4500, 9),
        rate: float = 50.0,
        count: int = 4,
        layers: Occlusion | None = None,
        light: tuple[float, float] = (1e5, 8.0),
        dead: float = 0.0,
        weights: Any = None,
        **limits: Any,
    ) -> Scene:
        given: dict[str, Any] = {"max_stroke": 60.0, "min_half_exposure": 1e-4}
        given["max_half_exposure"] = 0.04
        if isinstance(speeds, tuple):
            low, high, number = speeds
            speeds = np.linspace(low, high, number)
        return Scene(
            speeds,
            weights=weights,
            photon_rate=light[0],
            read_noise=light[1],
            limits=Limits(**(given | limits)),
            burst=BurstMode(frames_per_s=rate, max_frames=count, window=0.08, dead_time=dead),
            occlusion=layers,
        )

    one_way = (500, 4500, 9)
    return {
        "both ways": scene(),
        "one way": scene(one_way, max_pan=0.0),
        "one way, the camera pans": scene(one_way, pans="camera"),
        "one way, the stage pans": scene((300, 1200, 7), max_pan=900.0, pans="stage"),
        "slow": scene((-300, 300, 7)),
        "little stroke": scene(max_stroke=11.0),
        "bright": scene(light=(1e6, 2.0), count=8, rate=100.0),
        "dim": scene(light=(1e4, 8.0)),
        "quiet sensor": scene(light=(1e5, 0.7), count=8, rate=100.0),
        "three tenths move": scene(layers=Occlusion(front_share=0.3)),
        "six tenths move one way": scene(
            one_way, layers=Occlusion(front_share=0.6), max_pan=2e3, pans="stage"
        ),
        "two frames, dead time": scene(count=2, rate=30.0, dead=6e-3),
        "gentle stage": scene(count=8, rate=100.0, max_acceleration=1.6e5),
        "16 frames": scene(count=16, rate=200.0),
        "four frames of a fast camera": scene(rate=200.0),
        "four frames of a fast camera, dim": scene(rate=400.0, light=(1e4, 2.0)),
        "12 frames, little stroke": scene(count=12, rate=150.0, max_stroke=7.0, light=(1e6, 2.0)),
        "a stage that runs up": scene(
            layers=Occlusion(front_share=0.4), max_acceleration=3e5, max_travel=52.0
        ),
        "uneven speeds": scene(
            [-900, 0, 210, 380, 3700], weights=[0.3, 0.1, 0.3, 0.2, 0.1], max_pan=1500.0
        ),
        "one speed in ten": scene(
            [100, 300, 4000], weights=[0.6, 0.3, 0.1], max_pan=3e3, pans="camera"
        ),
    }


def measured(name: str, scene: Scene) -> dict[str, Any]:
    """Both searches of one scene."""
    begun = time.process_time()
    ours: tuple[FrameSequence, ...] = (best_still_burst(scene), best_moving_burst(scene))  # type: ignore[assignment]
    own, begun = time.process_time() - begun, time.process_time()
    camera, draw = Camera.of(scene), np.random.default_rng(0)
    (standing, split), (best, kind) = still(camera), moving(camera, draw)
    return {
        "scene": name,
        "still": ours[0].psnr,
        "found still": standing,
        "split": split,
        "moving": ours[1].psnr,
        "kind": f"{ours[1].kind}, {ours[1].setting}",
        "found moving": best,
        "its kind": kind,
        "lead": max(standing - ours[0].psnr, best - ours[1].psnr),
        "own_s": own,
        "seconds": time.process_time() - begun,
    }


def main(*names: str) -> None:
    """Measure, store and print; only the scenes of some names where there are any."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, scene in scenes().items():
        if not names or name in names:
            rows.append(measured(name, scene))
            print(rows[-1], flush=True)
    if names:
        return
    harness.write("bursts_search", rows)
    shown = [{k: f"{x:.3f}" if isinstance(x, float) else x for k, x in row.items()} for row in rows]
    text = TEXT.format(
        largest=max(row["lead"] for row in rows),
        allowed=ALLOWED,
        own=sum(row["own_s"] for row in rows),
        seconds=sum(row["seconds"] for row in rows),
        table=harness.table(shown, list(COLUMNS)),
    )
    harness.section("bursts_search", text)


if __name__ == "__main__":
    main(*sys.argv[1:])
