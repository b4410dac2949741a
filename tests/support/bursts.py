"""A camera that takes a burst of two frames, one of them at rest."""

from dataclasses import replace

from mishutter import (
    BurstMode,
    Design,
    Exposures,
    FreeMotion,
    HannShutter,
    Limits,
    Scene,
    StillCamera,
    TimedFrame,
)
from mishutter.design.design import given_design

SPEEDS = [-700.0, 0.0, 900.0]
LIMITS = Limits(max_stroke=40.0, max_half_exposure=0.012, max_acceleration=1.4e6)
FRAMES = (
    TimedFrame(StillCamera(half_exposure=0.0021), -0.009, 1.5),
    TimedFrame(FreeMotion(accelerations=[-2.3e5], half_exposure=0.0068), 0.009, 2.5),
)
SEQUENCE = Exposures("own", FRAMES, 13.7, 31.25, 30.75, registration_loss=0.0023, width_loss=0.17)


def a_burst_design(
    sequence: Exposures | None = SEQUENCE, limits: Limits = LIMITS, **others: object
) -> Design:
    """The design of a scene whose decoder finds the speed."""
    burst = BurstMode(frames_per_s=55.0, max_frames=2)
    scene = Scene(
        SPEEDS,
        photon_rate=1.3e6,
        read_noise=3.1,
        limits=limits,
        burst=burst,
        decoder_speed="found",
        **others,
    )
    return replace(given_design(scene, scene.motion, HannShutter(), "Given."), sequence=sequence)
