"""Knowledge of the speed: the levels, losses, filters and words of decoders, in one table.

One more decoder is a row of `SPEED_KNOWLEDGE`, under a name of `DecoderSpeed`: comparisons, sweeps,
restorations, tables, pictures and verdicts ask the row.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from jaxtyping import Array, Float

from mishutter.evaluation.errors import DecoderLevels, SpectralLevels
from mishutter.evaluation.found_speed import Number, found_share
from mishutter.evaluation.losses import (
    AbstractLoss,
    ExpectedErrorLoss,
    FoundSpeedLoss,
    KnownSpeedLoss,
    WorstSpeedLoss,
)
from mishutter.evaluation.metrics import METRICS, Metrics
from mishutter.model import DecoderSpeed, Scene


@dataclass(frozen=True)
class SpeedKnowledge:
    """A decoder's knowledge of the speed.

    Attributes:
        name: The knowledge, as `Scene.decoder_speed` names it.
        level: Name of the metric that is the PSNR expected of such a decoder.
        worst_level: Name of the metric at the worst of the speeds; None where the level is known
            in the mean over speeds alone.
        toleranced_level: Name of the metric within the scene's tolerances; None where that is not
            computed.
        loss: The expected error of such a decoder, which designs for it.
        worst_loss: The same at the worst of the speeds; None where the package has none.
        knows_speed: Whether it restores with the filter of one speed, and not with one for all.
        finds_speed: Whether it looks for that speed in the picture; otherwise it is told it.
        share: Share of the gain from knowing the speed, in decibels, that it keeps, by the
            `smear_difference`.
        filter_words: The filter that it restores with, wherever a speed that it finds is right.
        level_words: The decoder of a level, below a table.
        worst_words: The level at the worst speed, below a table.
        aside: What stands behind the name of a quantity that such a decoder gives.
        verb: What it does with the speed, in a sentence; None if it does nothing with it.
    """

    name: DecoderSpeed
    level: str
    worst_level: str | None
    toleranced_level: str | None
    loss: type[AbstractLoss]
    worst_loss: type[AbstractLoss] | None
    knows_speed: bool
    finds_speed: bool
    share: Callable[[Number], Number]
    filter_words: str
    level_words: str
    worst_words: str
    aside: str
    verb: str | None

    def judge(self, scene: Scene) -> str:
        """Name of the metric that judges designs for a scene, within its tolerances if it can.

        Args:
            scene: The scene.
        """
        if scene.tolerances is None or self.toleranced_level is None:
            return self.level
        return self.toleranced_level

    def levels(self, *, with_tolerances: bool) -> tuple[str, ...]:
        """Names of the metrics of this decoder, those within tolerances among them or not."""
        names = (self.level, self.worst_level, self.toleranced_level if with_tolerances else None)
        return tuple(name for name in names if name is not None)

    @property
    def words(self) -> dict[str, str]:
        """Its metrics in words, by their names."""
        by = f"by {self.level_words}"
        every = {
            self.level: by,
            self.toleranced_level: f"{by}, within the tolerances",
            self.worst_level: f"{by}, at the worst speed",
        }
        return {name: words for name, words in every.items() if name is not None}

    def psnr(self, metrics: Metrics) -> Float[Array, ""]:
        """PSNR expected of the decoder for a camera as designed; dB."""
        return getattr(metrics, self.level)

    def worst_psnr(self, metrics: Metrics) -> Float[Array, ""] | None:
        """PSNR at the worst of the speeds; dB. None where it is not known."""
        return None if self.worst_level is None else getattr(metrics, self.worst_level)

    def toleranced_psnr(self, metrics: Metrics) -> Float[Array, ""] | None:
        """PSNR within the scene's tolerances; dB. None where it is not computed, or without any."""
        return None if self.toleranced_level is None else getattr(metrics, self.toleranced_level)

    def of(self, levels: SpectralLevels) -> DecoderLevels:
        """Levels by frequency and speed of the filter that it restores with."""
        return levels.known if self.knows_speed else levels.unknown

    @property
    def is_told(self) -> bool:
        """Whether it knows the speed without looking for it."""
        return self.knows_speed and not self.finds_speed


_ROWS = (
    SpeedKnowledge(
        name="unknown",
        level="expected_psnr",
        worst_level="worst_speed_psnr",
        toleranced_level="toleranced_psnr",
        loss=ExpectedErrorLoss,
        worst_loss=WorstSpeedLoss,
        knows_speed=False,
        finds_speed=False,
        share=lambda difference: 0.0,
        filter_words="one filter for all speeds",
        level_words="one linear filter for all speeds",
        worst_words="at the worst of the speeds, of one linear filter for all",
        aside="",
        verb=None,
    ),
    SpeedKnowledge(
        name="found",
        level="found_speed_psnr",
        worst_level=None,
        toleranced_level=None,
        loss=FoundSpeedLoss,
        worst_loss=None,
        knows_speed=True,
        finds_speed=True,
        share=found_share,
        filter_words="a filter for the true speed",
        level_words="a decoder that finds the speed in the picture",
        worst_words="of a decoder that finds the speed is known in the mean alone",
        aside=", speed found",
        verb="finds",
    ),
    SpeedKnowledge(
        name="known",
        level="known_speed_psnr",
        worst_level="worst_known_speed_psnr",
        toleranced_level=None,
        loss=KnownSpeedLoss,
        worst_loss=None,
        knows_speed=True,
        finds_speed=False,
        share=lambda difference: 1.0,
        filter_words="a filter that knows the speed",
        level_words="a linear filter that knows the speed",
        worst_words="at the worst of the speeds, of a filter that knows it",
        aside=", speed known",
        verb="knows",
    ),
)
SPEED_KNOWLEDGE: dict[DecoderSpeed, SpeedKnowledge] = {row.name: row for row in _ROWS}
"""Every knowledge of the speed by its name."""
UNKNOWN_SPEED, KNOWN_SPEED = SPEED_KNOWLEDGE["unknown"], SPEED_KNOWLEDGE["known"]


def knowledge_of(scene: Scene, loss: AbstractLoss | None = None) -> SpeedKnowledge:
    """The knowledge of the decoder that a loss is the expected error of, or that a scene names.

    Args:
        scene: The scene.
        loss: The loss; any other loss than an expected error leaves the decoder to the scene.
    """
    of_loss = None if loss is None else loss.decoder_speed
    return SPEED_KNOWLEDGE[of_loss or scene.decoder_speed]


def knowledge_of_saved(loss_name: str, scene: Scene) -> SpeedKnowledge:
    """The knowledge of a saved design's decoder.

    Args:
        loss_name: Representation of the loss that the design minimises.
        scene: The scene, which names the decoder of any other loss.
    """
    name = loss_name.partition("(")[0]
    for each in _ROWS:
        if name in {loss.__name__ for loss in (each.loss, each.worst_loss) if loss is not None}:
            return each
    return knowledge_of(scene)


def is_of_worst_speed(loss_name: str) -> bool:
    """Whether a design is for the worst of the speeds, by the representation of its loss."""
    worst = {each.worst_loss.__name__ for each in _ROWS if each.worst_loss is not None}
    return loss_name.partition("(")[0] in worst


def loss_of_decoder(scene: Scene) -> AbstractLoss:
    """The expected error of the decoder that a scene names."""
    return knowledge_of(scene).loss()


def loss_of_level(level: str) -> AbstractLoss:
    """The loss of the decoder whose expected PSNR a metric is.

    Args:
        level: Name of the metric, of no worst speed.

    Raises:
        ValueError: if it is the metric of no decoder.
    """
    for each in _ROWS:
        if level in (each.level, each.toleranced_level):
            return each.loss()
    raise ValueError(f"`level` must be the expected PSNR of a decoder; got {level!r}.")


def metrics_of(knowledge: Iterable[SpeedKnowledge], *, with_tolerances: bool) -> tuple[str, ...]:
    """Names of the metrics of some decoders, and of those that are of no decoder, in order."""
    own = {name for each in knowledge for name in each.levels(with_tolerances=with_tolerances)}
    every = {name for each in _ROWS for name in each.levels(with_tolerances=True)}
    return tuple(name for name in METRICS if name in own or name not in every)
