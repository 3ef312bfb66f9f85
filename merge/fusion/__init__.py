"""Fusion of maps by accepted verdicts into one map (§4)."""
