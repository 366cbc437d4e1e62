"""Loops that go over memory once, compiled on this machine at their first call.

What PyTorch does in one pass for every operation, a compiled loop does in one altogether. Each of
them has a plain version in PyTorch beside it, for other devices, precisions and links.
"""
