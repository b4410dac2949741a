"""Run time against error: each script answers one question, runs alone and stores every sample."""
