"""Layers on a simulated display in the browser: one page, served on loopback or in one file."""
