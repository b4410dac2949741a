"""Knowledge of the speed: the levels, losses, filters and words of decoders, in one table.

One more decoder is its loss and a row of `SPEED_KNOWLEDGE`, under a name of `DecoderSpeed`:
comparisons, sweeps, restorations, tables, pictures and verdicts ask the row.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from mishutter._core.checks import require
from mishutter.evaluation.errors import DecoderLevels, LinearErrors, SpectralLevels, freely_aligned
from mishutter.evaluation.found_speed import FOUND_SHARE, Number, found_share, found_share_of
from mishutter.evaluation.losses import AbstractLoss, AbstractResponseLoss
from mishutter.evaluation.metrics import METRICS, Metrics, SequenceMetrics
from mishutter.evaluation.needs import ONLY_SPECTRA, Parts
from mishutter.evaluation.response import Response
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_whole

ALIGNMENTS = ("vertex", "free")


@dataclass(frozen=True)
class SpeedKnowledge:
    """A decoder's knowledge of the speed."""

    name: DecoderSpeed  # The knowledge, as `Scene.decoder_speed` names it
    level: str  # Name of the metric that is the PSNR expected of such a decoder
    # Name of the metric at the worst of the speeds; None where the level is known in the mean over
    # speeds alone
    worst_level: str | None
    toleranced_level: str | None  # The metric within tolerances; None if not computed
    loss: type[AbstractLoss]  # The expected error of such a decoder, which designs for it
    worst_loss: type[AbstractLoss] | None  # The same at the worst speed; None if there is none
    knows_speed: bool  # Whether it restores with the filter of one speed, and not with one for all
    finds_speed: bool  # Whether it looks for that speed in the picture; otherwise it is told it
    # Share of the gain from knowing the speed, in decibels, that it keeps, by the
    # `smear_difference`
    share: Callable[[Number], Number]
    filter_words: str  # The filter that it restores with, wherever a speed that it finds is right
    level_words: str  # The decoder of a level, below a table
    worst_words: str  # The level at the worst speed, below a table
    aside: str  # What stands behind the name of a quantity that such a decoder gives

    def judge(self, scene: Scene) -> str:
        """Name of the metric that judges designs for a scene, within its tolerances if it can."""
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

    def psnr(self, metrics: Metrics | SequenceMetrics) -> Float[Array, ""] | float:
        """PSNR expected of the decoder for a camera as designed; dB."""
        return getattr(metrics, self.level)

    def worst_psnr(self, metrics: Metrics | SequenceMetrics) -> Float[Array, ""] | float | None:
        """PSNR at the worst of the speeds; dB. None where it is not known."""
        return None if self.worst_level is None else getattr(metrics, self.worst_level)

    def toleranced_psnr(
        self, metrics: Metrics | SequenceMetrics
    ) -> Float[Array, ""] | float | None:
        """PSNR within the scene's tolerances; dB. None where it is not computed, or without any."""
        return None if self.toleranced_level is None else getattr(metrics, self.toleranced_level)

    def of(self, levels: SpectralLevels) -> DecoderLevels:
        """Levels by frequency and speed of the filter that it restores with."""
        return levels.known if self.knows_speed else levels.unknown

    @property
    def is_told(self) -> bool:
        """Whether it knows the speed without looking for it."""
        return self.knows_speed and not self.finds_speed


class AbstractSpectralLoss(AbstractResponseLoss):
    """A loss that reads transfer functions alone, as every expected error does."""

    @property
    def parts(self) -> Parts:
        return ONLY_SPECTRA


def _over_contrast(scene: Scene, squared: Float[Array, ""]) -> Float[Array, ""]:
    """Root of a squared error over the picture's deviation; 0 for a picture without any."""
    variance = scene.picture.deviation.astype(squared.dtype) ** 2
    textured = (variance > 0) & (squared > 0)
    ratio = jnp.where(textured, squared, 1.0) / jnp.where(textured, variance, 1.0)
    return jnp.where(textured, jnp.sqrt(ratio), 0.0)


@final
class ExpectedErrorLoss(AbstractSpectralLoss):
    r"""Expected RMS error of the restored picture over the picture's standard deviation.

    The square root of `LinearErrors.unknown` (the best single linear decoder for the
    scene's speeds) over $\sigma_f$: 0 for a perfect picture, 1 where nothing is gained
    over a grey one. 20 dB of PSNR are a factor of 10.

    Args:
        alignment: Place that the decoder gives the object of each speed: `"vertex"`, the vertex of
            its path or the end of the exposure nearest to one beyond, as the `alignment` of the
            motion is, or `"free"`, the place of least error. Free places gain most at speeds that
            the sensor does not keep up with; where it keeps up with all, they gain up to 0.01 dB.

    Raises:
        ValueError: if `alignment` is neither, or, when it is called, `"free"` before a background.
    """

    alignment: str = eqx.field(default="vertex", static=True)
    decoder_speed: ClassVar[DecoderSpeed | None] = "unknown"

    def __check_init__(self) -> None:
        requirement = f"be one of {', '.join(ALIGNMENTS)}"
        is_one = self.alignment in ALIGNMENTS
        require(is_one, "ExpectedErrorLoss(alignment=...)", requirement, self.alignment)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        if self.alignment == "free":
            response = freely_aligned(scene, motion, response, num_frequencies)
        squared = LinearErrors(scene, motion, response, num_frequencies).unknown
        return _over_contrast(scene, squared)


@final
class WorstSpeedLoss(AbstractSpectralLoss):
    r"""Expected RMS error over the picture's deviation at the scene's worst speed.

    $(\sum_i E_i^\beta)^{1/2\beta}/\sigma_f$ over the squared errors $E_i$ of one filter for all
    speeds at each speed that occurs (`LinearErrors.unknown_by_speed`), in the units of
    `ExpectedErrorLoss`, which it never falls below: a smooth maximum, which exceeds the largest of
    $n$ by at most a factor of $n^{1/2\beta}$, 0.01 dB for nine speeds. The filter is that of the
    least mean error, by the scene's weights. `Metrics.worst_speed_psnr` measures the maximum
    itself.
    """

    decoder_speed: ClassVar[DecoderSpeed | None] = "unknown"
    of_worst_speed: ClassVar[bool] = True

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        errors = LinearErrors(scene, motion, response, num_frequencies).unknown_by_speed
        occurring = jnp.where(scene.weights > 0, errors, 0.0)
        largest = jax.lax.stop_gradient(jnp.max(occurring))
        some = largest > 0
        share = jnp.where(some, occurring / jnp.where(some, largest, 1.0), 1.0)
        maximum = largest * jnp.sum(share**1000) ** (1 / 1000)  # beta is 1,000
        return _over_contrast(scene, jnp.where(some, maximum, 0.0))


UNKNOWN_SPEED = SpeedKnowledge(
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
)


@final
class FoundSpeedLoss(AbstractSpectralLoss):
    r"""Expected RMS error over the picture's deviation, of a decoder that finds the speed.

    $E_k^{s/2}E^{(1-s)/2}/\sigma_f$ of the squared errors $E_k$ of a decoder that knows the speed
    (`KnownSpeedLoss`) and $E$ of one filter for all speeds (`ExpectedErrorLoss`): in decibels, a
    share $s$ of the gain from knowing the speed. This `found_share` is 0 where the blur differs
    too little between speeds to tell them apart. On photographs an open shutter on a parabola keeps
    0.85 of the gain by total variation and 0.93 by the ensemble filter. A profile that tapers hides
    the speed and keeps some 0.43. As the share is the same for all profiles, it favours those that
    taper: the true lead of an open shutter over them is rather larger.

    Args:
        share: $s$ where the blur differs by enough, from 0 to 1; static.

    Raises:
        ValueError: if `share` is not within 0 and 1, or, when it is called, if the scene has a
            background: no single speed describes that picture.
    """

    share: float = eqx.field(default=FOUND_SHARE, static=True)
    decoder_speed: ClassVar[DecoderSpeed | None] = "found"

    def __check_init__(self) -> None:
        within = isinstance(self.share, float | int) and 0 <= self.share <= 1
        require(within, "FoundSpeedLoss(share=...)", "be from 0 to 1", self.share)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        require_whole(scene, "FoundSpeedLoss")
        errors = LinearErrors(scene, motion, response, num_frequencies)
        known, unknown = (_over_contrast(scene, x) for x in (errors.known, errors.unknown))
        share = found_share_of(scene, motion, response.efficiency, self.share).astype(known.dtype)
        # The mix of `found_psnr`, whose decibels have no slope where an error is 0.
        some = known > 0
        mixed = jnp.where(some, known, 1.0) ** share * jnp.where(some, unknown, 1.0) ** (1 - share)
        return jnp.where(some, mixed, 0.0)


FOUND_SPEED = SpeedKnowledge(
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
)


@final
class KnownSpeedLoss(AbstractSpectralLoss):
    r"""Expected RMS error over the picture's deviation, of a decoder that knows the speed.

    The square root of `LinearErrors.known` over $\sigma_f$, in the units of
    `ExpectedErrorLoss`, which it never exceeds: each speed has a linear filter of its own.
    `Metrics.known_speed_psnr` measures the same error.
    """

    decoder_speed: ClassVar[DecoderSpeed | None] = "known"

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int
    ) -> Float[Array, ""]:
        squared = LinearErrors(scene, motion, response, num_frequencies).known
        return _over_contrast(scene, squared)


KNOWN_SPEED = SpeedKnowledge(
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
)

SPEED_KNOWLEDGE: dict[DecoderSpeed, SpeedKnowledge] = {
    row.name: row for row in (UNKNOWN_SPEED, FOUND_SPEED, KNOWN_SPEED)
}
"""Every knowledge of the speed by its name."""


def knowledge_of(scene: Scene, loss: AbstractLoss | None = None) -> SpeedKnowledge:
    """The knowledge of the decoder that a loss is the expected error of, or that a scene names."""
    of_loss = None if loss is None else loss.decoder_speed
    return SPEED_KNOWLEDGE[of_loss or scene.decoder_speed]


def knowledge_of_saved(loss_name: str, scene: Scene) -> SpeedKnowledge:
    """The knowledge of a saved design's decoder."""
    name = loss_name.partition("(")[0]
    for each in SPEED_KNOWLEDGE.values():
        if name in {loss.__name__ for loss in (each.loss, each.worst_loss) if loss is not None}:
            return each
    return knowledge_of(scene)


def is_of_worst_speed(loss_name: str) -> bool:
    """Whether a design is for the worst of the speeds, by the representation of its loss."""
    worst = {
        each.worst_loss.__name__ for each in SPEED_KNOWLEDGE.values() if each.worst_loss is not None
    }
    return loss_name.partition("(")[0] in worst


def loss_of_decoder(scene: Scene) -> AbstractLoss:
    """The expected error of the decoder that a scene names."""
    return knowledge_of(scene).loss()


def loss_of_level(level: str) -> AbstractLoss:
    """The loss of the decoder whose expected PSNR a metric is."""
    for each in SPEED_KNOWLEDGE.values():
        if level in (each.level, each.toleranced_level):
            return each.loss()
    raise ValueError(f"`level` must be the expected PSNR of a decoder; got {level!r}.")


def metrics_of(knowledge: Iterable[SpeedKnowledge], *, with_tolerances: bool) -> tuple[str, ...]:
    """Names of the metrics of some decoders, and of those that are of no decoder, in order."""
    own = {name for each in knowledge for name in each.levels(with_tolerances=with_tolerances)}
    every = {
        name for each in SPEED_KNOWLEDGE.values() for name in each.levels(with_tolerances=True)
    }
    return tuple(name for name in METRICS if name in own or name not in every)
