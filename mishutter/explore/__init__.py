"""The live page: a scene whose design follows the hand."""
