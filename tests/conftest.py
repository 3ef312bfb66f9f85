"""Properties are tried without a limit of time: machines are shared, and no test is timed."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
