"""Published results, measured again: figures, and a verdict on every claim."""
