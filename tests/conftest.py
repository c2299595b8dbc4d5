"""Hypothesis for all tests: the same examples every time, and no verdict on how long a busy machine takes to draw them."""

from hypothesis import HealthCheck, settings

settings.register_profile("structid", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("structid")
