"""The attitude-tracking task as pure functions of numpy arrays.

The leaf that every other package shares, so that no equation of the task exists twice.
SI units and radians throughout; imports numpy and msgspec alone.
"""
