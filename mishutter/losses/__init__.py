"""Losses: what a design is judged by."""

from mishutter.losses.base import AbstractLoss as AbstractLoss
from mishutter.losses.base import AbstractResponseLoss as AbstractResponseLoss
from mishutter.losses.base import WeightedSum as WeightedSum
from mishutter.losses.design import DesignLoss as DesignLoss
from mishutter.losses.expected_error import ExpectedErrorLoss as ExpectedErrorLoss
