"""What a topological map is: values, SE(2) geometry, structural matching, loop closure, documents.

Imports nothing else of this project.
"""
