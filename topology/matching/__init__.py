"""Structural matching: evidence that vertices and corridors of two maps are the same."""
