"""Light fields rendered from 3D models."""
