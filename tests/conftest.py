"""Settings all tests share: generated cases are the same in every run, and no test is judged by its time."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
