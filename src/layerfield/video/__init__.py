"""Videos of layers: made batch by batch, here or on Ray, and kept while they are made."""
