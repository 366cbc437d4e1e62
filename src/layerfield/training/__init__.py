"""Training: recipes, data, one loop."""
