"""Containers of recorded messages (MCAP, ROS 1 bags, ROS 2 sqlite3) and their decoding.

Every container is scanned block by block; a block is one buffer with the offsets of the wanted
messages in it, so that decoding can work on whole columns. Declared sizes are never trusted.
"""
