"""Scripted flights: what happens, how it is flown, scored and reported."""
