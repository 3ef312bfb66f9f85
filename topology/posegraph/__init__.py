"""Least-squares pose graphs in the plane, on `scipy.sparse`."""
