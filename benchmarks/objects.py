"""Are several things before a background found, and is their picture as good as told?

Two or three details of photographs move in any direction before another photograph; frames, times,
noise and the greatest speed are all that is given. Of each scene the picture is restored blind,
with outlines and velocities told, and from one frame at the instant of the picture.

Photographs are those of scikit-image, scikit-learn and PyWavelets, which are to be installed.
Scenes that `results/objects.json` holds already are not done again: remove it to begin anew.
"""

import importlib.util
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

import mishutter as ms
from benchmarks import harness
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.arrangement import Thing as Found
from mishutter.decoding.objects.composite import Alone, composite, trusted
from mishutter.decoding.objects.finding import found_in
from mishutter.decoding.objects.light import Misfit, Sight, light_of
from mishutter.decoding.objects.restored import knowledge_of
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.images import GAMMA, read_picture

SIZE, BORDER = 256, 24
"""Rows and columns of a frame, and of what lies beyond on each side; px."""
NUM_SCENES = 20
FASTEST, PERIOD, EXPOSURE = 1200.0, 0.02, 0.004
LIGHTS = ((1e5, 8.0), (3e4, 2.0), (3e5, 2.0))
"""Photo-electrons of white a second, and read noise; e-."""
FRAMES = (4, 8)
SEED = 71
PHOTOGRAPHS = (
    "sklearn/datasets/images/china.jpg",
    "sklearn/datasets/images/flower.jpg",
    "pywt/data/aero.npz",
    "pywt/data/ascent.npz",
    "skimage/data/brick.png",
    "skimage/data/chelsea.png",
    "skimage/data/coffee.png",
    "skimage/data/coins.png",
    "skimage/data/grass.png",
    "skimage/data/ihc.png",
    "skimage/data/moon.png",
    "skimage/data/retina.jpg",
    "skimage/data/rocket.jpg",
)
"""Photographs by which no outline was tuned; of the first four nothing at all was seen."""
DECODERS = {"linear": ms.EnsembleDecoder(), "total variation": ms.TotalVariationDecoder()}
SEEN = (0, 2, 4)
"""Scenes that were looked at while the last step of outlines was built."""
EVERY_FLAT = 5
"""Of so many scenes one has an object without texture."""
WRONG = 3.0
"""Error of a pixel that is trusted from which on it is wrong, in the noise of one frame."""
MATCHED = 4.0
"""Distance over the frames within which a velocity is an object's; px."""
TEXT = """## Several things before a background

{count} scenes of {size} x {size} px, {unseen} of which were not seen while the decoder was built,
details of photographs before a photograph: 2 or 3 objects of 40 to 130 px at 124 to 1,140 px/s in
any direction, 4 or 8 frames of 4 ms at 50/s, three lights, one scene in {every} with an object
without texture. PSNR of the picture, dB:

{table}

Blind less told, linear: {told:+.2f} dB in the mean, {told_middle:+.2f} in the median,
{told_worst:+.2f} at worst, and {told_unseen:+.2f} in the mean of those not seen. Total variation
object by object less the same decoder on a frame at that instant: {gain:+.2f} dB in the mean,
{gain_worst:+.2f} at least. Of {objects} objects {missed} missed, {invented} invented. {trust:.0%}
of pixels are trusted, of which {wrong:.2%} err by more than three standard deviations of one
frame. Of the velocities, {within:.0%} are within two errors ({flat} of those without texture), and
{scenes} of {count} scenes have all of theirs; the median is off by {median:.2f} px/s.
{seconds:.0f} processor seconds a scene, both decoders together."""


class Thing(NamedTuple):
    """A detail of a photograph that moves."""

    light: np.ndarray  # Coefficients of its spline
    centre: np.ndarray  # Row and column at the instant of the picture
    radius: float  # px
    velocity: np.ndarray  # Down and across; px/s
    waves: np.ndarray  # Share of the radius, and phase, of waves of the outline
    is_flat: bool


@dataclass(frozen=True)
class Scene:
    """Things before a photograph."""

    ground: np.ndarray
    things: list[Thing]
    num_frames: int
    rate: float
    read_noise: float
    seed: int

    @property
    def times(self) -> np.ndarray:
        """Mid-exposures since the instant of the picture; s."""
        return (np.arange(self.num_frames) - (self.num_frames - 1) / 2) * PERIOD

    def shown(self, time: float) -> tuple[np.ndarray, list[np.ndarray]]:
        """The picture at a time, with its border, and the share of each thing in it."""
        picture, mattes = self.ground.copy(), []
        rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(float)
        for each in self.things:
            y, x = (
                at - BORDER - centre - way
                for at, centre, way in zip(
                    (rows, columns), each.centre, each.velocity * time, strict=True
                )
            )
            angle = np.arctan2(y, x)
            reach = 1 + sum(
                share * np.cos(number * angle + phase)
                for number, (share, phase) in zip((2, 3, 5), each.waves, strict=True)
            )
            matte = np.clip(0.5 + each.radius * reach - np.hypot(y, x), 0, 1)
            inside, middle = matte > 0, each.light.shape[0] / 2
            places = [y[inside] + middle, x[inside] + middle]
            light = ndimage.map_coordinates(
                each.light, places, order=3, mode="mirror", prefilter=False
            )
            picture[inside] += matte[inside] * (np.clip(light, 0, 1) - picture[inside])
            mattes = [one * (1 - matte) for one in mattes] + [matte]
        return picture, mattes

    def frame(self, time: float, random: np.random.Generator) -> np.ndarray:
        """A frame of pixels that average the light that falls on them."""
        fastest = max(float(np.hypot(*each.velocity)) for each in self.things)
        steps = max(2, int(np.ceil(1.5 * fastest * EXPOSURE)))
        instants = time + EXPOSURE * ((np.arange(steps) + 0.5) / steps - 0.5)
        light = np.mean([self.shown(instant)[0] for instant in instants], axis=0)
        down, across = np.fft.fftfreq(light.shape[0])[:, None], np.fft.rfftfreq(light.shape[1])
        seen = np.fft.rfft2(light) * np.sinc(down) * np.sinc(across)
        light = np.maximum(inner(np.fft.irfft2(seen, light.shape)), 0)
        electrons = self.rate * EXPOSURE
        counts = random.poisson(light * electrons) + random.normal(0, self.read_noise, light.shape)
        return counts / electrons

    def stills(self, frames: np.ndarray, times: np.ndarray) -> Stills:
        """Frames as the decoder has them."""
        exposures = np.full(len(times), EXPOSURE)
        light, electrons = frames.astype(np.float32), self.rate * exposures
        return Stills(light, times, exposures, electrons, self.read_noise, FASTEST, (True, True))


def inner(picture: np.ndarray) -> np.ndarray:
    """A picture without its border."""
    return picture[BORDER:-BORDER, BORDER:-BORDER]


def photograph(name: str, size: int, random: np.random.Generator) -> np.ndarray:
    """A piece of a photograph in linear light; small ones go on mirrored."""
    package, _, file_name = name.partition("/")
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"install {package} for {name}")
    path = Path(spec.origin).parent / file_name
    if path.suffix == ".npz":
        light = (np.load(path)["data"] / 255.0) ** GAMMA
    else:
        light = np.asarray(read_picture(path).luminance, float)
    light = np.pad(light, [(0, max(0, size - n)) for n in light.shape], mode="symmetric")
    top, left = (int(random.integers(0, n - size + 1)) for n in light.shape)
    return light[top : top + size, left : left + size]


def scene(number: int, seed: int = SEED) -> Scene:
    """A scene of random photographs, outlines, places and velocities."""
    random = np.random.default_rng([number, seed])
    names = random.permutation(PHOTOGRAPHS)
    count, num_frames = int(random.integers(2, 4)), FRAMES[number % 2]
    ground, things = photograph(str(names[0]), SIZE + 2 * BORDER, random), []
    furthest = (num_frames - 1) / 2 * PERIOD
    for k in range(count):
        radius = float(random.uniform(20, 65))
        centre, velocity = np.zeros(2), np.zeros(2)
        for _ in range(500):
            angle, speed = random.uniform(0, 2 * np.pi), random.uniform(124, 1140)
            velocity = speed * np.array([np.sin(angle), np.cos(angle)])
            centre = random.uniform(0.9 * radius, SIZE - 0.9 * radius, 2)
            ends = np.array([centre - furthest * velocity, centre + furthest * velocity])
            near = [np.hypot(*(centre - o.centre)) < 0.75 * (radius + o.radius) for o in things]
            if ends.min() > -0.2 * radius and ends.max() < SIZE + 0.2 * radius and not any(near):
                break
        light = photograph(str(names[1 + k]), 200, random)
        is_flat = k == 0 and number % EVERY_FLAT == 0
        if is_flat:
            light = np.full((200, 200), random.uniform(0.15, 0.8))
        waves = np.stack([random.uniform(0, 0.14, 3), random.uniform(0, 2 * np.pi, 3)], axis=1)
        spline = ndimage.spline_filter(light, order=3, mode="mirror")
        things.append(Thing(spline, centre, radius, velocity, waves, is_flat))
    rate, read_noise = LIGHTS[(number // 2) % len(LIGHTS)]
    return Scene(ground, things, num_frames, rate, read_noise, number)


def decibels(picture: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of a picture whose light is no less than nothing."""
    return float(-10 * np.log10(np.mean((np.maximum(picture, 0) - truth) ** 2)))


def row_of(number: int) -> dict:
    """What is restored of a scene."""
    made = scene(number)
    random = np.random.default_rng([number, SEED + 2])
    stills = made.stills(np.array([made.frame(t, random) for t in made.times]), made.times)
    instant = made.stills(made.frame(0.0, random)[None], np.zeros(1))
    picture, shares = made.shown(0.0)
    truth, mattes = inner(picture), [inner(one) for one in shares]
    whole = [inner(alone(made, k).shown(0.0)[1][0]) for k in range(len(made.things))]
    camera = ms.Scene.any_direction(FASTEST, photon_rate=made.rate, read_noise=made.read_noise)
    known = knowledge_of(camera, stills, in_plane=True)
    told = Arrangement(
        stills,
        [
            Found(each.velocity, matte.astype(np.float32), each.velocity, 1.0)
            for each, matte in zip(made.things, whole, strict=True)
        ],
        list(range(len(made.things)))[::-1],
    )
    row: dict = {"scene": number, "frames": made.num_frames, "rate": made.rate}
    began = time.process_time()
    found = found_in(stills, known=known)
    row["find s"] = time.process_time() - began
    for name, decoder in DECODERS.items():
        alone_of = Alone.of(stills, known, decoder)
        for kind, arrangement in (("blind", found), ("told", told)):
            if kind == "told" and name != "linear":
                continue
            began = time.process_time()
            misfit = Misfit.of(Sight.of(stills, arrangement, known))
            picture = composite(arrangement, misfit, light_of(misfit, decoder), alone_of)
            row[f"{kind} {name} s"] = time.process_time() - began
            row[f"{kind}, {name}"] = decibels(picture.light, truth)
            if kind == "blind":
                trust = trusted(arrangement, picture)
                noise = np.sqrt(stills.noise(truth, stills.middle))
                wrong = np.abs(picture.light - truth) > WRONG * noise
                row[f"{name} trusted"] = float(trust.mean())
                row[f"{name} wrong"] = float(wrong[trust].mean())
        one = Alone.of(instant, knowledge_of(camera, instant, in_plane=True), decoder)
        row[f"one frame, {name}"] = decibels(one.light, truth)
    return row | velocities_of(made, found, mattes)


def alone(made: Scene, number: int) -> Scene:
    """A scene of one of the things."""
    return Scene(made.ground, [made.things[number]], made.num_frames, made.rate, 0.0, made.seed)


def velocities_of(made: Scene, found: Arrangement, mattes: list[np.ndarray]) -> dict:
    """Errors of velocities, and what is missed and invented."""
    span, pairs = float(np.ptp(made.times)), []
    for k, each in enumerate(made.things):
        away = [float(np.hypot(*(one.velocity - each.velocity))) for one in found.things]
        near = int(np.argmin([*away, np.inf]))
        # The same velocity elsewhere is another object.
        if near < len(away) and away[near] * span < MATCHED:
            overlap = np.sum(np.minimum(found.things[near].matte, mattes[k]))
            if overlap > 0.3 * np.sum(mattes[k]):
                pairs.append((k, near))
    errors, scores = [], []
    for k, near in pairs:
        off = found.things[near].velocity - made.things[k].velocity
        variance = max(float(np.linalg.eigvalsh(found.things[near].covariance)[-1]), 1e-12)
        errors.append(float(np.hypot(*off)))
        scores.append(float(np.sqrt(off @ np.linalg.solve(found.things[near].covariance, off) / 2)))
        scores[-1] = min(scores[-1], errors[-1] / np.sqrt(variance))
    return {
        "objects": len(made.things),
        "missed": len(made.things) - len(pairs),
        "invented": len(found.things) - len({near for _, near in pairs}),
        "off": errors,
        "scores": scores,
        "flat": [made.things[k].is_flat for k, _ in pairs],
    }


def table_of(rows: list[dict]) -> str:
    """Mean levels by light and number of frames, and over all."""
    names = [f"{kind}, {name}" for name in DECODERS for kind in ("one frame", "told", "blind")]
    names.remove("told, total variation")
    table = []
    for rate, read_noise in LIGHTS:
        for count in FRAMES:
            mine = [r for r in rows if (r["rate"], r["frames"]) == (rate, count)]
            if mine:
                head = {"light": f"{rate:.0e} e-/s, {read_noise:g} e-", "frames": str(count)}
                table.append(head | {n: f"{np.mean([r[n] for r in mine]):.2f}" for n in names})
    total = {n: f"{np.mean([r[n] for r in rows]):.2f}" for n in names}
    table.append({"light": "all", "frames": ""} | total)
    return harness.table(table, ["light", "frames", *names])


def report(rows: list[dict]) -> None:
    """Print, and keep for `RESULTS.md`."""
    told = np.array([r["blind, linear"] - r["told, linear"] for r in rows])
    kind = "total variation"
    gains = np.array([r[f"blind, {kind}"] - r[f"one frame, {kind}"] for r in rows])
    scores = np.concatenate([r["scores"] for r in rows])
    flat = np.concatenate([r["flat"] for r in rows]).astype(bool)
    text = TEXT.format(
        count=len(rows),
        unseen=sum(r["scene"] not in SEEN for r in rows),
        size=SIZE,
        every=EVERY_FLAT,
        table=table_of(rows),
        told=told.mean(),
        told_middle=np.median(told),
        told_unseen=np.mean([d for d, r in zip(told, rows, strict=True) if r["scene"] not in SEEN]),
        told_worst=told.min(),
        gain=gains.mean(),
        gain_worst=gains.min(),
        objects=sum(r["objects"] for r in rows),
        missed=sum(r["missed"] for r in rows),
        invented=sum(r["invented"] for r in rows),
        trust=np.mean([r["linear trusted"] for r in rows]),
        wrong=np.mean([r["linear wrong"] for r in rows]),
        within=np.mean(scores < 2),
        flat=f"{np.sum(scores[flat] < 2)} of {flat.sum()}",
        scenes=sum(max(r["scores"], default=0) < 2 for r in rows),
        median=np.median(np.concatenate([r["off"] for r in rows])),
        seconds=np.mean([sum(v for k, v in r.items() if k.endswith(" s")) for r in rows]),
    )
    harness.section("objects", text)


def main(count: int = NUM_SCENES) -> None:
    """Measure scene by scene, store each, and print."""
    path = harness.RESULTS / "objects.json"
    rows = json.loads(path.read_text("utf-8"))["rows"] if path.exists() else []
    for number in range(count):
        if all(row["scene"] != number for row in rows):
            rows.append(row_of(number))
            harness.write("objects", rows)
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    report(rows)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
