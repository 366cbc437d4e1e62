"""Light fields in, layers out."""
