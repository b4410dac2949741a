"""The gain of a coded camera where part of the picture stands still behind moving objects."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from mishutter._core import alone_in_blas, outside_trace, require_known
from mishutter.evaluation import ExpectedErrorLoss, knowledge_of
from mishutter.model import Occlusion, Scene, require_scene
from mishutter.search import RivalSearch, Row, best_row, optimise, snapshots

STILL_SHARES = (0.5, 0.7)
"""Shares of a picture that stand still, in the gains that stand beside a verdict."""
OBJECT_WIDTH = 100.0
"""Width of the objects before it; px."""
DESIGNED = "designed"
"""Name of a camera that was designed for a picture with a background."""
_NUM_STARTS = 2
"""Starts of a search, which on the built-in scene and the slides finds what four and eight do."""
_NAMED = 0.05
"""Least gain before a background that the sentence names; dB."""


@dataclass(frozen=True)
class BackgroundGain:
    """The gain of the best camera for a picture of which a share stands still.

    Attributes:
        still_share: Share of the picture that stands still.
        gain: Expected PSNR above that of the best snapshot for the same picture; dB.
        camera: The best camera, a snapshot where no other is worth its parts; None if unknown.
    """

    still_share: float
    gain: float
    camera: Row | None = field(default=None, repr=False)


@alone_in_blas()
@outside_trace()
def background_gains(
    scene: Scene,
    *,
    begin: Callable[[str], None] = lambda name: None,
) -> tuple[BackgroundGain, ...]:
    """Gains of the best cameras where half of the picture stands still, and where 70 % do.

    A profile and a motion are searched for each, from few starts, before a still background with
    objects of 100 px. A scene that says what hides what has none, nor has one whose decoder knows
    the speed of a picture, nor one in which nothing moves.

    Args:
        scene: Speeds, light, noise and limits.
        begin: Called with the name of each search before it begins.

    Raises:
        ValueError: if the scene is none or is traced.
    """
    require_scene(scene)
    require_known("background_gains", scene=scene)
    is_whole = scene.occlusion is None and not knowledge_of(scene).knows_speed
    if not is_whole or float(scene.max_speed) == 0:
        return ()
    gains, loss = [], ExpectedErrorLoss()
    for share in STILL_SHARES:
        begin(f"{share:.0%} still")
        layered = before_still_background(scene, share)
        snapshot = best_row(snapshots(RivalSearch(layered, loss)))
        start = scene.fullest_motion if scene.motion.is_straight else scene.motion
        design = optimise(layered, start, loss=loss, num_starts=_NUM_STARTS)
        camera = replace(
            snapshot,
            name=DESIGNED,
            shutter=design.shutter,
            motion=design.motion,
            metrics=design.metrics,
        )
        gain = max(camera.level - snapshot.level, 0.0)
        gains.append(BackgroundGain(share, gain, camera if gain >= _NAMED else snapshot))
    return tuple(gains)


def before_still_background(scene: Scene, still_share: float) -> Scene:
    """The same scene with its objects before a background that stands still.

    Args:
        scene: The scene.
        still_share: Share of the picture that stands still.
    """
    layers = Occlusion(front_share=1 - still_share, object_width=OBJECT_WIDTH)
    return scene.with_occlusion(layers)


def background_line(gains: tuple[BackgroundGain, ...]) -> str:
    """The sentence on the gains that remain before a background; empty without gains."""
    if not gains:
        return ""
    parts = []
    for each in gains:
        of_picture = "half of the picture" if each.still_share == 0.5 else f"{each.still_share:.0%}"
        gain = f"{each.gain:+.2f} dB" if each.gain >= _NAMED else "none"
        parts.append(f"{gain} where {of_picture} stands still")
    return (
        "This is of a picture that moves as a whole. Objects that move before a background leave "
        f"another gain: {', '.join(parts)}, by a camera designed for it."
    )
