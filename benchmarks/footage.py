"""Is the picture of people and animals, which layers do not explain, no worse than one frame's?

Clips of cameras at rest are the truth of bursts of five frames: each is given the noise of a camera
and restored object by object, and by its middle frame alone. Where each was cut from, and under
which licence, stands in `footage/LICENSES.md`.
"""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.objects import DECODERS, EXPOSURE, WRONG, decibels
from mishutter.decoding.objects.composite import Alone, composite, trusted
from mishutter.decoding.objects.finding import found_in
from mishutter.decoding.objects.light import Misfit, Sight, light_of
from mishutter.decoding.objects.restored import knowledge_of
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.images import read_picture

CLIPS = {
    "walking": ("a person walks", 0.1),
    "signing": ("hands sign", 1 / 15),
    "turning_cars": ("cars turn", 0.08),
    "mouse": ("a mouse", 1 / 30),
}
"""Each with the time between its frames, in which exposures are short; s."""
FASTEST = 24.0
"""Greatest way from one frame to the next; px."""
RATE, READ_NOISE = 1e5, 8.0
WINDOW = 32
"""Side of the windows in which pictures are compared; px."""
PICTURE = Path(__file__).parents[1] / "docs" / "figures" / "footage.png"
TEXT = """## Footage of what is not rigid

Five frames of each clip, given the noise of a camera of 1e5 e-/s, 4 ms and 8 e-; PSNR, dB, of the
picture object by object and of its middle frame by the same decoder. `worst window` is the least
difference of both over windows of {window} px of which most is trusted; `wrong` is the share of
trusted pixels that err by more than three standard deviations of one frame.

{table}"""


def light_in(name: str) -> np.ndarray:
    """Linear light of the frames of a clip."""
    path = Path(__file__).parent / "footage" / f"{name}.png"
    strip = np.asarray(read_picture(path).luminance, float)
    return np.stack(np.split(strip, strip.shape[1] // strip.shape[0], axis=1))


def through_pixels(light: np.ndarray) -> np.ndarray:
    """Light that pixels average, as those of the decoder do; borders go on mirrored."""
    padded = np.pad(light, 16, mode="symmetric")
    down, across = np.fft.fftfreq(padded.shape[0])[:, None], np.fft.rfftfreq(padded.shape[1])
    seen = np.fft.irfft2(np.fft.rfft2(padded) * np.sinc(down) * np.sinc(across), padded.shape)
    return np.maximum(seen[16:-16, 16:-16], 0)


def worst_window(
    pictures: tuple[np.ndarray, np.ndarray], truth: np.ndarray, trust: np.ndarray
) -> float:
    """Least difference in level of two pictures, of the trusted pixels of a window; dB."""
    worst = np.inf
    for top in range(0, truth.shape[0] - WINDOW + 1, WINDOW // 2):
        for left in range(0, truth.shape[1] - WINDOW + 1, WINDOW // 2):
            part = np.s_[top : top + WINDOW, left : left + WINDOW]
            own = trust[part]
            if own.mean() > 0.5:
                one, other = (decibels(p[part][own], truth[part][own]) for p in pictures)
                worst = min(worst, one - other)
    return worst


def rows_of(name: str) -> tuple[list[dict], list[np.ndarray]]:
    """A row for each decoder, and the pictures of the figure."""
    clip, period = CLIPS[name]
    fastest = FASTEST / period
    light, random = light_in(name), np.random.default_rng(0)
    electrons = RATE * EXPOSURE
    frames = np.array(
        [
            (random.poisson(one * electrons) + random.normal(0, READ_NOISE, one.shape)) / electrons
            for one in map(through_pixels, light)
        ]
    )
    count = len(light)
    times = (np.arange(count) - (count - 1) / 2) * period
    exposures, moves = np.full(count, EXPOSURE), (True, True)
    signal = RATE * exposures
    shown = frames.astype(np.float32)
    stills = Stills(shown, times, exposures, signal, READ_NOISE, fastest, moves)
    camera = ms.Scene.any_direction(fastest, photon_rate=RATE, read_noise=READ_NOISE)
    known = knowledge_of(camera, stills, in_plane=True)
    truth, found = light[stills.middle], found_in(stills, known=known)
    misfit = Misfit.of(Sight.of(stills, found, known))
    rows, pictures = [], []
    for kind, decoder in DECODERS.items():
        alone = Alone.of(stills, known, decoder)
        made = composite(found, misfit, light_of(misfit, decoder), alone)
        trust, noise = trusted(found, made), np.sqrt(stills.noise(truth, stills.middle))
        levels = [decibels(one, truth) for one in (alone.light, made.light)]
        worst = worst_window((made.light, alone.light), truth, trust)
        wrong = np.mean((np.abs(made.light - truth) > WRONG * noise)[trust])
        row = {"clip": clip, "decoder": kind, "one frame": f"{levels[0]:.2f}"}
        row |= {"object by object": f"{levels[1]:.2f}", "gain": f"{levels[1] - levels[0]:+.2f}"}
        row |= {"trusted": f"{trust.mean():.0%}", "wrong": f"{wrong:.2%}"}
        rows.append(row | {"worst window": f"{worst:+.2f}"})
        pictures = [shown[stills.middle], alone.light, made.light, made.alone, trust]
    return rows, [truth, *pictures]


def draw(pictures: list[list[np.ndarray]]) -> None:
    """Save the figure of the page."""
    titles = "truth", "frame", "frame restored", "object by object", "share of the frame", "trust"
    figure, axes = plt.subplots(len(pictures), 6, figsize=(12, 8.3), layout="constrained")
    for line, each in zip(axes, pictures, strict=True):
        for number, (panel, picture) in enumerate(zip(line, each, strict=True)):
            seen = np.clip(picture, 0, 1)
            panel.imshow(seen ** (1 / 2.2) if number < 4 else seen, cmap="gray", vmin=0, vmax=1)
            panel.set_axis_off()
    for panel, title in zip(axes[0], titles, strict=True):
        panel.set_title(title, fontsize=10)
    figure.savefig(PICTURE, dpi=80)


def main() -> None:
    """Measure, store, draw and print."""
    made = []
    for name in CLIPS:
        made.append(rows_of(name))
        print(made[-1][0], file=sys.stderr, flush=True)
    rows = [row for each, _ in made for row in each]
    harness.write("footage", rows)
    draw([pictures for _, pictures in made])
    table = harness.table(rows, list(rows[0]))
    harness.section("footage", TEXT.format(window=WINDOW, table=table))


if __name__ == "__main__":
    sys.exit(main())
