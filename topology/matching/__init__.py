"""Structural matching: what makes vertices and corridors of two maps the same ones."""
