"""The design search: space, objective, minimisation, rivals."""
