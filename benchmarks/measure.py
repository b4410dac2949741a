"""Does `measure` find the noise, the objects and the scene of clips whose truth is known?

Clips are simulated from photographs by `tests/support/clips.py`. A typical printout stands in
`RESULTS.md`.
"""

import io
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax
import numpy as np
from PIL import Image

jax.config.update("jax_enable_x64", True)

from support.clips import OTHERS, PHOTOGRAPHS, ClipOf, Thing  # noqa: E402
from support.places import PLACES, Place, best_frames  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402
from mishutter.measurement.clip import clip_of  # noqa: E402
from mishutter.measurement.measurement import noise_from  # noqa: E402
from mishutter.measurement.noise import Noise  # noqa: E402

NOISES = ((300, 2.0), (1000, 8.0), (1000, 4.0), (3000, 4.0), (10_000, 4.0))
"""Photo-electrons at white, and read noise; e-."""
DEPTHS = (8, 12, 16)
NUM_CLIPS = 48
"""Clips of two objects each."""
QUALITIES = (100, 98, 95, 80)
GAMMAS = (1.5, 1.8, 2.2)
LIGHTS = (300, 1000, 10_000)
SETS = {"chosen by": PHOTOGRAPHS, "others": OTHERS}
"""Photographs by whose clips thresholds were chosen, and others, of other objects and seeds."""
SPEEDS = (0.15, 0.3, 0.5, 0.8, 1.1, 1.4)
"""Speeds of slow objects; px a frame."""
PAIRS = (
    ((0, 2), (0, 3.2)),
    ((1.5, 1), (-1, 1)),
    ((0, 1), (0, -1)),
    ((2, 2), (2, 1)),
    ((0, 4), (1.2, 4)),
    ((3, 0), (-3, 0)),
    ((0.8, 0), (-0.8, 0)),
    ((0.5, 0.5), (0, 1.2)),
)
"""Velocities of two objects that touch, down and to the right; px a frame."""
_OF_OTHERS = 3000
"""First seed of those."""
TEXT = """## A scene measured from a clip

**Noise.** Eight frames of 256 x 256 of photographs before which two objects move, five noises and
three depths: {num_noise} clips, each with two dark frames, or with black told where level 0 cuts
dark frames off. `electrons` is the share within 10 % of the truth and the farthest, `read` the
share within 20 % and the farthest; `within two` the share of errors that hold the truth. A read
noise below half a step of the file is refused. Of the ten photographs by which thresholds were
chosen:

{noise}

Of eight others, with other objects and seeds:

{others}

Within two errors: electrons {electrons_chosen:.0%} and {electrons_others:.0%} of all, read noise
{read_chosen:.0%} and {read_others:.0%}.

**Clips that are refused.** The same clips of 8 bits after a JPEG, or coded by a gamma, without dark
frames: share in which no number is written, + that in which one is and a gamma is named beside it.

{refused}

**Objects.** {num_clips} clips of 4 to 16 frames, 300 to 10,000 e-, of two objects of 72 to 120 px
at up to 10 px a frame in random directions: {found} of {objects} within 1.5 px over the clip
({visible} of those that show at least 2,000 px in the reference frame), {false} others. The median
error is {median:.2f} px over the clip, and {cover:.0%} of the errors of either axis hold the truth
within two. The share at rest is off by {share_median:.3f} in the median and {share_worst:.3f} at
most.

**Slow and touching objects.** Clips of 176 x 192 of photographs; found
is what is within 0.5 px over the clip.

{close}

**There and back.** Clips simulated from a scene, whose objects are of the photograph behind them,
and measured: the frames to take, for a decoder that registers objects, and their level less what
registration and the width of the sensor cost.

{back}

A clip of 16 frames of 512 x 512 takes {seconds:.0f} s of one core at the load of the run."""


def thing(rng: np.random.Generator, centre: tuple[float, float], name: str) -> Thing:
    """An object of a random size and velocity."""
    axes = tuple(rng.uniform(36, 60, 2))
    return Thing(centre, axes, tuple(rng.uniform(-500, 500, 2)), name)


def two_things(seed: int) -> tuple[Thing, Thing]:
    """Two objects at random velocities."""
    rng = np.random.default_rng([seed, 3])
    photographs = PHOTOGRAPHS if seed < _OF_OTHERS else OTHERS
    names = [photographs[(seed + i) % len(photographs)] for i in (3, 7)]
    return thing(rng, (85, 85), names[0]), thing(rng, (170, 165), names[1])


def still_clips(**others: Any) -> Iterator[tuple[str, str, ClipOf]]:
    """A clip of each photograph with its set and name; eight frames of 256 x 256."""
    for number, (which, photographs) in enumerate(SETS.items()):
        for k, name in enumerate(photographs):
            seed = number * _OF_OTHERS + k
            yield which, name, ClipOf(two_things(seed), background=name, seed=seed, **others)


def measured(clip: ClipOf, levels: np.ndarray, **others: Any) -> ms.Measurement:
    """The measurement of a clip."""
    return ms.measure(
        levels,
        frames_per_s=clip.frames_per_s,
        exposure=clip.exposure,
        white=float(clip.full),
        **others,
    )


def noise_rows() -> list[dict]:
    """One row for each clip of the noises."""
    rows = []
    for which, name, base in still_clips():
        lights = [base.exposed(t) for t in base.times]
        for electrons, read in NOISES:
            for bits in DEPTHS:
                clip = replace(base, electrons=electrons, read_noise=read, bits=bits)
                rng = np.random.default_rng([base.seed, bits, electrons])
                levels = np.stack([clip.recorded(light, rng) for light in lights])
                dark = clip.dark()
                told = (
                    {"black": float(clip.black_level)}
                    if np.mean(dark == 0) > 0.01
                    else {"dark": dark}
                )
                noise = measured_noise(clip, levels, **told)
                row = {"set": which, "photograph": name, "electrons": electrons, "read": read}
                row["bits"] = bits
                row["steps"] = read * clip.per_electron
                for key, truth, found in (
                    ("electrons", electrons, noise.electrons_at_white),
                    ("read", read, noise.read_noise),
                ):
                    if found is not None:
                        row[f"{key} ratio"] = found.value / truth
                        row[f"{key} score"] = (found.value - truth) / found.error
                row["refusals"] = [each.text for each in noise.refusals]
                rows.append(row)
    return rows


def measured_noise(clip: ClipOf, levels: np.ndarray, **told: Any) -> Noise:
    """The noise alone."""
    given = clip_of(levels, clip.frames_per_s, None, float(clip.full))
    return noise_from(given, **told)[1]


def refused_rows() -> list[dict]:
    """Whether clips after a JPEG, or coded by a gamma, are refused."""
    rows = []
    for electrons in LIGHTS:
        for which, name, clip in still_clips(electrons=electrons, bits=8):
            levels = clip.levels()
            coded = {f"JPEG {q}": np.stack([jpeg(f, q) for f in levels]) for q in QUALITIES}
            deep = replace(clip, bits=16, black=0.0).levels() / 65535
            for gamma in GAMMAS:
                coded[f"gamma {gamma:g}"] = np.rint(255 * deep ** (1 / gamma)).astype(np.uint8)
            coded["none"] = levels
            for kind, frames in coded.items():
                given = clip_of(frames, clip.frames_per_s, None, float(clip.full))
                found, noise = noise_from(given)
                row = {"set": which, "photograph": name, "kind": kind, "electrons": electrons}
                row["refused"] = noise.electrons_at_white is None
                row["doubted"] = any("gamma" in word for word in found.words)
                row["refusals"] = [each.reason for each in noise.refusals]
                rows.append(row)
    return rows


def jpeg(frame: np.ndarray, quality: int) -> np.ndarray:
    """A frame after a JPEG of a quality."""
    content = io.BytesIO()
    Image.fromarray(frame).save(content, "JPEG", quality=quality)
    return np.asarray(Image.open(content))


def object_rows(count: int) -> list[dict]:
    """One row for each clip of two objects."""
    rows = []
    for seed in range(count):
        clip = ClipOf(
            two_things(seed),
            background=PHOTOGRAPHS[seed % 10],
            num_frames=(4, 6, 8, 16)[seed % 4],
            electrons=(300, 1000, 3000, 10_000)[(seed // 4) % 4],
            seed=seed,
        )
        found = measured(clip, clip.levels(), black=float(clip.black_level))
        labels = clip.labels(clip.times[found.motion.frame])
        span = (clip.num_frames - 1) / clip.frames_per_s
        each = [np.array(o.velocity) for o in found.motion.objects]
        row = {"seed": seed, "share": found.motion.share_at_rest - np.mean(labels == 0)}
        row |= {"off": [], "visible": [], "scores": []}
        for number, thing in enumerate(clip.things, 1):
            truth = np.array(thing.velocity)
            away = [float(np.hypot(*(v - truth)) * span) for v in each]
            best = int(np.argmin([*away, 99.0]))
            row["off"].append([*away, 99.0][best])
            row["visible"].append(int(np.sum(labels == number)))
            if row["off"][-1] < 1.5:
                error = found.motion.objects[best].error
                row["scores"] += list((each[best] - truth) / np.array(error))
        truths = [np.array(t.velocity) for t in clip.things]
        row["false"] = sum(min(np.hypot(*(v - t)) * span for t in truths) > 1.5 for v in each)
        rows.append(row)
    return rows


def close_rows() -> list[dict]:
    """One row for each clip of an object that is near rest, or of two that touch."""
    size, rows = (176, 192), []
    for k, (speed, count) in enumerate((s, n) for s in SPEEDS for n in (8, 16)):
        way = np.random.default_rng([k, 5]).uniform(0, 2 * np.pi)
        velocity = 50 * speed * np.sin(way), 50 * speed * np.cos(way)
        things = (Thing((88, 96), (34, 30), velocity, PHOTOGRAPHS[(k + 4) % 10]),)
        clip = ClipOf(things, size, PHOTOGRAPHS[k % 10], count, seed=k)
        rows += [{"kind": f"{speed:g} px a frame"} | row for row in found_in(clip)]
    for k, (pair, count) in enumerate((p, n) for p in PAIRS for n in (6, 12)):
        (one, other), names = 50 * np.array(pair), [PHOTOGRAPHS[(k + i) % 10] for i in (3, 7)]
        things = (
            Thing((88, 66), (36, 36), tuple(one), names[0]),
            Thing((88, 126), (34, 34), tuple(other), names[1]),
        )
        clip = ClipOf(things, size, PHOTOGRAPHS[k % 10], count, seed=20 + k)
        rows += [{"kind": "two that touch"} | row for row in found_in(clip)]
    return rows


def found_in(base: ClipOf) -> Iterator[dict]:
    """What is found of a clip in dim and in bright light."""
    for electrons in (300, 3000):
        clip = replace(base, electrons=electrons)
        span = (clip.num_frames - 1) / clip.frames_per_s
        found = measured(clip, clip.levels(), black=float(clip.black_level)).motion.objects
        each = [np.array(o.velocity) for o in found]
        off = [
            min([float(np.hypot(*(v - thing.velocity))) * span for v in each], default=99.0)
            for thing in clip.things
        ]
        truths = [np.array(thing.velocity) for thing in clip.things]
        others = sum(min(np.hypot(*(v - t)) * span for t in truths) > 1.5 for v in each)
        yield {"frames": clip.num_frames, "electrons": electrons, "off": off, "others": int(others)}


def close_table(rows: list[dict]) -> list[dict]:
    """How many are found, by kind and light."""
    table = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        row: dict = {"objects": kind}
        for electrons in (300, 3000):
            mine = [r for r in rows if (r["kind"], r["electrons"]) == (kind, electrons)]
            off = np.concatenate([r["off"] for r in mine])
            row[f"found, {electrons:,} e-"] = f"{np.sum(off < 0.5)} of {off.size}"
        row["others"] = str(sum(r["others"] for r in rows if r["kind"] == kind))
        table.append(row)
    return table


def back_rows() -> list[dict]:
    """Scenes, the clips that they give, and the answers of both."""
    return [there_and_back(name, place) for name, place in PLACES.items()]


def there_and_back(name: str, place: Place) -> dict:
    """A scene and the one that is measured from its clip, answered."""
    clip = place.clip
    found = measured(clip, clip.levels(), dark=clip.dark())
    truth = place.scene_like(found.scene)
    row: dict = {"scene": name}
    levels = []
    for kind, scene in (("true", truth), ("measured", found.scene)):
        option, level = best_frames(scene)
        row |= {f"{kind}: take": option, f"{kind} dB": f"{level:.2f}"}
        levels.append(level)
    return row | {"measured less true": f"{levels[1] - levels[0]:+.2f}"}


def noise_table(rows: list[dict]) -> list[dict]:
    """Shares and worst cases by noise and depth."""
    table = []
    for electrons, read in NOISES:
        for bits in DEPTHS:
            mine = [
                r for r in rows if (r["electrons"], r["read"], r["bits"]) == (electrons, read, bits)
            ]
            row = {"e-": f"{electrons:,}", "read e-": f"{read:g}", "bits": str(bits)}
            row["noise in steps"] = f"{mine[0]['steps']:.2g}"
            for key, most in (("electrons", 0.1), ("read", 0.2)):
                ratios = np.array([r[f"{key} ratio"] for r in mine if f"{key} ratio" in r])
                scores = np.array([r[f"{key} score"] for r in mine if f"{key} score" in r])
                row[f"{key} written"] = f"{ratios.size} of {len(mine)}"
                far = np.abs(ratios - 1)
                some = ratios.size > 0
                row[f"{key} within {most:.0%}"] = f"{np.mean(far < most):.0%}" if some else "-"
                row[f"{key} farthest"] = f"{far.max():.1%}" if some else "-"
                row[f"{key} within two"] = f"{np.mean(np.abs(scores) < 2):.0%}" if some else "-"
            table.append(row)
    return table


def refused_table(rows: list[dict]) -> list[dict]:
    """Share that is refused by kind and light."""
    table = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        row = {"coded by": kind}
        for which in SETS:
            for electrons in LIGHTS:
                key = which, kind, electrons
                mine = [r for r in rows if (r["set"], r["kind"], r["electrons"]) == key]
                refused, doubted = (np.mean([r[k] for r in mine]) for k in ("refused", "doubted"))
                text = f"{refused:.0%}" + (f" + {doubted:.0%}" if doubted else "")
                row[f"{which}, {electrons:,} e-"] = text
        table.append(row)
    return table


def seconds_of_a_large_clip() -> float:
    """Processor time of 16 frames of 512 x 512."""
    things = tuple(replace(t, centre=(2 * t.centre[0], 2 * t.centre[1])) for t in two_things(1))
    clip = ClipOf(things, size=(512, 512), background="camera.png", num_frames=16)
    levels = clip.levels()
    start = time.process_time()
    measured(clip, levels, black=float(clip.black_level))
    return time.process_time() - start


def report(parts: dict[str, list[dict]], seconds: float) -> None:
    """Store and print."""
    harness.write("measure", [{"part": k, **row} for k, rows in parts.items() for row in rows])
    noise, objects = parts["noise"], parts["objects"]
    covers = {
        f"{key}_{which.split()[0]}": np.mean(
            [abs(r[f"{key} score"]) < 2 for r in noise if r["set"] == which and f"{key} score" in r]
        )
        for key in ("electrons", "read")
        for which in SETS
    }
    off = np.array([x for row in objects for x in row["off"]])
    visible = np.array([x for row in objects for x in row["visible"]]) >= 2000
    scores = np.array([x for row in objects for x in row["scores"]])
    shares = np.abs([row["share"] for row in objects])
    is_found = off < 1.5
    of_noise = [noise_table([r for r in noise if r["set"] == which]) for which in SETS]
    close = close_table(parts["close"])
    tables = *of_noise, refused_table(parts["refused"]), close, parts["back"]
    noise_text, others, refused, near, back = (harness.table(t, list(t[0])) for t in tables)
    text = TEXT.format(
        num_noise=len(noise),
        noise=noise_text,
        others=others,
        **covers,
        refused=refused,
        num_clips=len(objects),
        found=int(is_found.sum()),
        objects=off.size,
        visible=f"{int((is_found & visible).sum())} of {int(visible.sum())}",
        false=sum(row["false"] for row in objects),
        median=float(np.median(off[is_found])),
        cover=float(np.mean(np.abs(scores) < 2)),
        share_median=float(np.median(shares)),
        share_worst=float(shares.max()),
        close=near,
        back=back,
        seconds=seconds,
    )
    harness.section("measure", text)


def main(count: int = NUM_CLIPS) -> None:
    """Measure, store and print."""
    seconds = seconds_of_a_large_clip()
    parts = {}
    for name, rows in (
        ("noise", noise_rows),
        ("refused", refused_rows),
        ("objects", lambda: object_rows(count)),
        ("close", close_rows),
        ("back", back_rows),
    ):
        start = time.perf_counter()
        parts[name] = rows()
        print(name, f"{time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    report(parts, seconds)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
