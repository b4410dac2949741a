"""The gain of a coded camera where part of the picture stands still behind moving objects."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from mishutter._core.checks import require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.design.design import Design
from mishutter.evaluation.speed_knowledge import ExpectedErrorLoss, knowledge_of
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Scene, require_scene
from mishutter.report.verdict import paragraph
from mishutter.search.rivals import RivalSearch, snapshot_designs
from mishutter.search.search import optimise

STILL_SHARES = (0.5, 0.7)
"""Shares of a picture that stand still, in the gains that stand beside a verdict."""
_NAMED = 0.05
"""Least gain before a background that the sentence names; dB."""


@dataclass(frozen=True)
class BackgroundGain:
    """The gain of the best camera for a picture of which a share stands still."""

    still_share: float  # Share of the picture that stands still
    gain: float  # Expected PSNR above that of the best snapshot for the same picture; dB
    # The best camera, a snapshot where no other is worth its parts; None if unknown
    camera: Design | None = field(default=None, repr=False)

    @property
    def is_named(self) -> bool:
        """Whether the gain is one that the sentence names, of a camera that is no snapshot."""
        return self.gain >= _NAMED


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
        # The loss is the root of a squared error, and tells the gain without any other metric.
        own = snapshot_designs(RivalSearch(layered, loss))
        snapshot = min(own.values(), key=lambda design: design.loss)
        start = scene.fullest_motion if scene.motion.is_straight else scene.motion
        # Two starts find what four and eight do, on the built-in scene and the slides.
        design = optimise(layered, start, loss=loss, num_starts=2)
        gain = max(20 * math.log10(snapshot.loss / design.loss), 0.0)
        gains.append(BackgroundGain(share, gain, design if gain >= _NAMED else snapshot))
    return tuple(gains)


def before_still_background(scene: Scene, still_share: float) -> Scene:
    """The same scene with objects of 100 px before a background that stands still."""
    return scene.with_occlusion(Occlusion(front_share=1 - still_share, object_width=100.0))


def background_line(gains: tuple[BackgroundGain, ...]) -> str:
    """The sentence on the gains that remain before a background; empty without gains."""
    if not gains:
        return ""
    parts = []
    for each in gains:
        of_picture = "half of the picture" if each.still_share == 0.5 else f"{each.still_share:.0%}"
        gain = f"{each.gain:.2f} dB" if each.is_named else "nothing"
        parts.append(f"{gain} where {of_picture} stands still")
    return paragraph(
        "This is for a picture that moves as a whole. For objects that move before a background, a "
        f"camera designed for them gains {' and '.join(parts)}."
    )
