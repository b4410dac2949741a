"""Losses, by which designs are judged."""

from mishutter.evaluation.losses.base import AbstractLoss as AbstractLoss
from mishutter.evaluation.losses.base import AbstractResponseLoss as AbstractResponseLoss
from mishutter.evaluation.losses.base import WeightedSum as WeightedSum
from mishutter.evaluation.losses.design import DesignLoss as DesignLoss
from mishutter.evaluation.losses.expected_error import ExpectedErrorLoss as ExpectedErrorLoss
