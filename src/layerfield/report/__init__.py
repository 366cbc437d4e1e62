"""Figures that people can read."""
