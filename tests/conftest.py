"""Properties are tried without a limit of time: machines are shared, and no test is timed. Where
`CI` is set they are tried with the same examples every time, so that a change is judged by what it
changes; elsewhere with new ones."""

import os

from hypothesis import HealthCheck, settings

settings.register_profile(
    "untimed",
    deadline=None,
    derandomize=bool(os.environ.get("CI")),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("untimed")
