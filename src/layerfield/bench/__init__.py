"""Time, operations and memory of methods from 8-bit views to 8-bit panels, and what they reach."""
