"""A design whose drive table is written."""

import numpy as np

from mishutter import Design, OneExposure, Outcome
from support.designs import MOTION, SCENE


def a_design(shutter, motion=MOTION, scene=SCENE):
    one = OneExposure(
        shutter=shutter,
        motion=motion,
        loss=0.3,
        history=np.array([0.3]),
        outcome=Outcome.CONVERGED,
        certificate=1e-9,
        loss_name="ExpectedErrorLoss()",
        best_start_loss=0.3,
    )
    return Design(scene, one=one)
