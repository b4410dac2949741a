"""A design whose drive table is written."""

import numpy as np

from mishutter import (
    Design,
)
from mishutter.design.design import Outcome
from support.designs import MOTION, SCENE


def a_design(shutter):
    return Design(
        shutter=shutter,
        motion=MOTION,
        scene=SCENE,
        loss=0.3,
        history=np.array([0.3]),
        outcome=Outcome.CONVERGED,
        certificate=1e-9,
        loss_name="ExpectedErrorLoss()",
        best_start_loss=0.3,
    )
