"""topobatch: recorded robot runs to topological maps, and maps of many runs merged.

Importing the package does nothing but define names; the heavy libraries (rerun, rosbags,
scipy.optimize) are imported by the functions that use them.
"""

__version__ = "0.1.0"
