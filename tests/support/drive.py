"""A design whose drive table is written."""

import numpy as np

from mishutter import Design, OneExposure, Outcome
from support.designs import MOTION, SCENE


def a_design(shutter):
    one = OneExposure(
        shutter=shutter,
        motion=MOTION,
        loss=0.3,
        history=np.array([0.3]),
        outcome=Outcome.CONVERGED,
        certificate=1e-9,
        loss_name="ExpectedErrorLoss()",
        best_start_loss=0.3,
    )
    return Design(SCENE, one=one)
