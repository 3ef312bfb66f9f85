"""Simulated runs: worlds, robots that explore them, their logs, and the ground truth.

`simulate_scenario` makes runs in memory, `write_scenario` writes their logs in any container. The
same settings give the same runs, and logs with the same messages, on any machine.
"""
