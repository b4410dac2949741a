"""Evaluation of a design: needs of a scene, response, metrics and losses."""
