"""Errors with units against truth folders, and the figures of a session: the same numbers in tests, reports and benchmarks."""
