"""Layer images for compressive, tensor and layered light field displays."""

__version__ = "0.1.0"
